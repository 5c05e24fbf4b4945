"""Writes a picture to a file, whole or not at all."""

import io
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from daemon.base.errors import UserError
from daemon.base.files import atomic_output_path

# Removes the time of writing that an SVG or a PDF would contain: the same figure has to give the same bytes.
_UNDATED_METADATA: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def save_picture(figure: Figure, path: Path, dpi: float = 120.0) -> None:
    """Write a figure to a PNG, SVG or PDF file, its folder too; the same figure gives the same bytes.

    Raises
    ------
    UserError
        The file cannot be written. What was there stays.
    """
    kind = path.suffix.removeprefix(".").lower()
    # Draw in memory: on a full disk the library would fail in several ways, not with one error.
    content = io.BytesIO()
    # Without a fixed salt the names of an SVG's parts are random.
    with rc_context({"svg.hashsalt": "heliocube"}):
        figure.savefig(content, format=kind, dpi=dpi, metadata=_UNDATED_METADATA.get(kind, {}))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output_path(path) as part:
            part.write_bytes(content.getvalue())
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
