"""Writes reports: the folder is checked before the work, and no file is overwritten without --force."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import tzinfo
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.files import atomic_text_file
from daemon.config.settings import Settings
from daemon.store.outputs import check_folder, check_outputs
from daemon.studies.report.material import Material
from daemon.studies.report.page import findings_of, page_of

ENDING = ".html"


def check_output(out: Path, names: Sequence[str], option: str, *, force: bool) -> None:
    """Raise `UserError` if the folder cannot take files, or has one of these names already.

    To be called before the work whose results go there; it makes and changes nothing.
    """
    check_folder(out, option)
    check_outputs([out / name for name in names], option, force=force)


def file_name(span_name: str, tracker: str) -> str:
    """Return the file name of a tracker's report; characters of its name that a file may not have are replaced."""
    return f"{span_name}-{re.sub(r'[^A-Za-z0-9_.-]', '_', tracker) or 'tracker'}{ENDING}"


def with_settings(material: Material, settings: Settings | None) -> Material:
    """Return the material with the limits and the budget that the configuration of its tracker sets."""
    if settings is None:
        return material
    # The records of a tracker without a name of its own have the name of its role.
    own = dict(settings.trackers).get(material.tracker, settings if not settings.tracker else None)
    if own is None:
        return material
    return replace(
        material,
        limits=own.limits.limits(),
        budget_deg=own.motion.travel_per_day_deg,
        budget_moves=own.motion.moves_per_day,
        stow_wind_m_s=own.safety.stow_wind_m_s,
    )


def write_reports(
    materials: Sequence[Material], out: Path, zone: tzinfo | None, progress: Callable[[float], None], *, force: bool
) -> list[Path]:
    """Write the page of each tracker to the folder `out` and return their paths.

    Raises
    ------
    UserError
        A page is there already and not to be overwritten, or cannot be written.
    """
    names = [file_name(material.span.name, material.tracker) for material in materials]
    check_output(out, names, "--out", force=force)
    paths = []
    for number, (material, name) in enumerate(zip(materials, names, strict=True)):
        paths.append(write_text(out / name, page_of(findings_of(material, zone))))
        progress((number + 1) / len(names))
    return paths


def write_text(path: Path, text: str) -> Path:
    """Write a file whole or not at all, its folder made if it is missing; raises `UserError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_text_file(path, errors="backslashreplace") as file:
            file.write(text)
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
    return path
