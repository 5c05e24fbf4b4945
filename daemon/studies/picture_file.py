"""A picture as a file: whole, or not there."""

import io
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from daemon.base.errors import UserError
from daemon.base.files import part_of

# Instants that an SVG or a PDF would have in it.
_UNDATED: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def save_picture(figure: Figure, path: Path, dpi: float = 120.0) -> None:
    """Write a figure to a PNG, SVG or PDF file, its folder too; the same figure gives the same bytes.

    Raises
    ------
    UserError
        The file cannot be written. What was there stays.
    """
    kind = path.suffix.removeprefix(".").lower()
    # In memory: what a full disk does to the library while it draws is not one error, but several.
    content = io.BytesIO()
    # What names an SVG's parts is random otherwise.
    with rc_context({"svg.hashsalt": "heliocube"}):
        figure.savefig(content, format=kind, dpi=dpi, metadata=_UNDATED.get(kind, {}))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part_of(path) as part:
            part.write_bytes(content.getvalue())
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
