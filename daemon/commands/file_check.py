"""Finds everything in a configuration file that `heliocube run` would refuse."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.commands.options import RoleChoice, unit_role

if TYPE_CHECKING:
    from collections.abc import Callable

    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.settings import Settings


def check_file(
    path: Path, role: RoleChoice | None = None, look: "Callable[[Settings], list[str]] | None" = None
) -> "Settings":
    """Read a file like `load_settings`, and also check everything that `heliocube run` would need.

    Parameters
    ----------
    path
        The file.
    role
        What the process will do. None: the role of the unit that starts this file, or, without such a unit, any role
        that can run.
    look
        Looks for more problems, and returns a sentence for each.

    Raises
    ------
    ConfigError
        All problems, and what the role lacks.
    """
    from daemon.api.token import TokenError, load_token
    from daemon.base.errors import UserError
    from daemon.bridge.signing import KeyFileError, load_key
    from daemon.commands.records_folder import with_records_folder
    from daemon.config.file import ConfigError, load_settings_with_topics
    from daemon.config.section import resolve_file_paths
    from daemon.cube.calibration import calibration_to_run
    from daemon.mqtt.credentials import CredentialsError, load_user, tls_context
    from daemon.mqtt.topics import find_topic_errors
    from daemon.notify.recipients import recipients_of

    role = role or unit_role(path)
    settings = with_records_folder(load_settings_with_topics(path, find_topic_errors), path, os.environ)
    problems = []
    if role is not RoleChoice.tracker:
        # The calibration file is on the machine that reads the cube.
        try:
            calibration_to_run(settings)
        except UserError as error:
            problems.append(f"cube.calibration_file: {error}")
    if settings.bridge.key_file is not None:
        try:
            load_key(settings.bridge.key_file)
        except KeyFileError as error:
            problems.append(f"bridge.key_file: {error}")
    if settings.api.token_file is not None:
        try:
            load_token(settings.api.token_file)
        except TokenError as error:
            problems.append(f"api.token_file: {error}")
    mqtt = settings.mqtt
    try:
        if mqtt.credentials_file is not None:
            load_user(mqtt.credentials_file)
        if mqtt.tls:
            tls_context(mqtt)
    except CredentialsError as error:
        problems.append(str(error))
    if settings.notify.people_file is not None:
        try:
            # Relative to the configuration file, as in heliocube notify.
            recipients_of(resolve_file_paths(path, settings.notify).people_file)
        except UserError as error:
            problems.append(str(error))
    weather = settings.simulation.weather
    if isinstance(weather, Path) and not settings.real:
        from daemon.studies.inputs import check_weather_file

        try:
            check_weather_file(weather)
            # Import late: the reader of weather takes seconds to load.
            from daemon.rigs.measured import read_weather

            read_weather(weather)
        except UserError as error:
            problems.append(f"simulation.weather: {error}")
    if settings.store.directory is not None:
        problems += _unwritable(settings.store.directory)
    # On the simulated rig every file can run in the role both. To check that would take longer than all the rest.
    if settings.real or role is not None:
        found = missing_requirements_by_role(settings)
        asked = list(found) if role is None else [role]
        if all(found[each] for each in asked):
            roles: dict[str, list[str]] = {}
            for each in asked:
                for sentence in found[each]:
                    roles.setdefault(sentence, []).append(each)
            problems += [
                f"as {' or '.join(names)}: {sentence}"
                for sentence, names in roles.items()
                if not _is_mentioned(sentence, problems)
            ]
    if look is not None:
        problems += [sentence for sentence in look(settings) if not _is_mentioned(sentence, problems)]
    if problems:
        raise ConfigError(str(path), problems)
    return settings


def missing_requirements_by_role(settings: "Settings") -> dict[RoleChoice, list[str]]:
    """Return for each role why it cannot run with these settings; an empty list if it can."""
    from daemon.commands.run import missing_requirements
    from daemon.service.rig import Role

    return {role: missing_requirements(settings, Role(role.value)) for role in RoleChoice}


def absent_addresses(settings: "Settings") -> list[str]:
    """Return a sentence for each address to listen on that this machine does not have now: a service waits for it."""
    from daemon.base.addresses import is_local_address, parse_address

    bridge = settings.bridge
    named = {"bridge.listen": bridge.listen}
    if bridge.multicast_interface is not None:
        named["bridge.multicast_interface"] = f"{bridge.multicast_interface}:0"
    named |= {
        f"{name}.listen": part.listen
        for name, part in (("api", settings.api), ("sunspec", settings.sunspec))
        if part.enabled
    }
    return [
        f"{key}: {parse_address(text).host} is not an address of this machine now; until it is, a service"
        " waits for it and receives nothing there"
        for key, text in named.items()
        if not is_local_address(parse_address(text))
    ]


def _is_mentioned(sentence: str, problems: list[str]) -> bool:
    """Tell whether a sentence is in the list already, under another key."""
    return any(sentence in problem for problem in problems)


def _unwritable(directory: Path) -> list[str]:
    try:
        there = next(each for each in (directory, *directory.absolute().parents) if each.exists())
    except OSError as error:
        return [f"store.directory: {error.strerror}; name another folder"]
    if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
        return []
    why = "may not be written to by this user" if there.is_dir() else "is not a folder"
    sentence = (
        f"store.directory: {there} {why}, so nothing would be kept in {directory}; check as the user that the service"
        " runs as, or name another folder"
    )
    return [sentence]
