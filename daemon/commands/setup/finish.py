"""The end of a setup: the configuration, with every key explained, and the secrets beside it."""

import contextlib
import shutil
import sys
from itertools import count
from pathlib import Path
from typing import Literal, cast

from daemon.api.token import generate_token, write_token
from daemon.base.errors import UserError
from daemon.base.files import replace_file, rewrite_file
from daemon.bridge.signing import generate_key, write_key
from daemon.commands.options import unit_role
from daemon.commands.setup.dialogue import SetupDialogue
from daemon.config.template import render_config
from daemon.store.records_folder import RECORDS_NAME, SYSTEMD_STATE_FOLDER


def write_setup_files(dialogue: SetupDialogue, file: Path) -> list[str]:
    """Write the configuration, and its key and token if they are not there yet; return a line for each file.

    Raises
    ------
    UserError
        A file cannot be written. Files written before it stay, and the setup may be continued.
    """
    values = dialogue.values()
    role = cast("Literal['both', 'cube', 'tracker']", dialogue.role())
    # A unit may write only to its own folder.
    place = str(SYSTEMD_STATE_FOLDER / role) if unit_role(file) == role else RECORDS_NAME
    values["store.directory"] = values.get("store.directory") or place
    text = render_config(role, values, dialogue.context.chosen_drivers())
    done = []
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        key, token = (
            file.parent / Path(str(values[name])).expanduser() for name in ("bridge.key_file", "api.token_file")
        )
        model = next((path for path in (token, file) if path.exists()), None)
        for path in (key, token):
            if not path.exists():
                write_key(path, generate_key()) if path == key else write_token(path, generate_token())
                _copy_owner(model, path, alone=path == key)
                done.append(f"{path}, new")
        if file.exists():
            old = _free_name(file)
            shutil.copy2(file, old)
            done.append(f"{old}, the configuration before")
            rewrite_file(file, text)
        else:
            replace_file(file, text)
        _copy_owner(model, file)
    except OSError as error:
        raise UserError(f"{error.filename or file.parent} cannot be written: {error.strerror}") from None
    return [f"{file}, the configuration", *done]


def start_lines(file: Path, role: str) -> list[str]:
    """Return the lines that start the service with a configuration: by its unit, if the installation has one for it."""
    if unit_role(file) != role:
        return [f"heliocube run --role {role} --config {file}"]
    if role == "cube":
        return ["sudo systemctl start heliocube-cube"]
    return [
        "switch the motors' supply off: docs/install.md, section 6",
        "sudo systemctl start heliocube-tracker; heliocube hold",
    ]


def _free_name(file: Path) -> Path:
    names = (file.with_name(f"{file.name}.before{'' if number == 1 else f'-{number}'}") for number in count(1))
    return next(path for path in names if not path.exists())


def _copy_owner(model: Path | None, path: Path, *, alone: bool = False) -> None:
    """Give a file that root has written to the owner of `model`, since the service's user could not read it otherwise.

    With `alone` only its owner may read the file. If the owner of `model` is root, such a file goes to the user who has
    the name of the group of `model`: that is the service's user, as deploy/ sets it up.
    """
    if model is None or model == path or sys.platform == "win32":
        return
    # Windows has no such module.
    import grp

    with contextlib.suppress(OSError):
        owner = model.stat()
        shutil.chown(path, owner.st_uid, owner.st_gid)
        if alone and owner.st_uid == 0:
            with contextlib.suppress(LookupError):
                shutil.chown(path, grp.getgrgid(owner.st_gid).gr_name)
