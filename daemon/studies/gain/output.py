"""Columns of numbers as a table on the terminal, as CSV at full precision, or as Parquet."""

import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.files import atomic_output_path
from daemon.base.words import pluralise
from daemon.studies.gain.choices import AnswerFormat, Device
from daemon.studies.gain.evaluate import Columns
from daemon.studies.text_table import signed, table

MOST_ROWS, MOST_ROWS_BESIDE_A_FIGURE = 200, 12
_SHOWN_AS_ZERO = 1e-9
_CSV_BLOCK_ROWS = 50_000
_NAMES = {Device.STATIC: "static panel", Device.VERTICAL: "vertical axis", Device.HORIZONTAL: "horizontal axis"}
_RATIO = {Device.STATIC: "K_DS_clip", Device.VERTICAL: "K_DV", Device.HORIZONTAL: "K_DH"}
_INPUT_COLUMNS = ("phi_deg", "beta_deg", "lambda_deg", "n")
_LEGEND = """\
K: the dual axis over a static panel (K_DS; _clip for one face, _abs for both),
a vertical axis (K_DV) or the paper's horizontal axis (K_DH).
eta_VS, eta_HS: what those two axes gain over the static panel."""
_ETA = {Device.VERTICAL: "eta_VS", Device.HORIZONTAL: "eta_HS"}


def write(
    columns: Columns,
    kind: AnswerFormat,
    out: Path | None,
    console: Console,
    sky_label: str | None,
    *,
    most_rows: int = MOST_ROWS,
) -> None:
    """Write `columns` to `out`, or to standard output if it is None; `UserError` if that cannot be done.

    A table has at most `most_rows` rows and says how many more there are.
    """
    if kind is AnswerFormat.TABLE:
        if out is not None:
            raise UserError("--out takes a CSV or a Parquet file; add --format csv or --format parquet")
        _show(columns, console, sky_label, most_rows)
        return
    encode = _csv if kind is AnswerFormat.CSV else _parquet
    if out is None:
        if kind is AnswerFormat.PARQUET and sys.stdout.isatty():
            raise UserError("Parquet is not for a terminal; give a file with --out")
        encode(columns, sys.stdout.buffer)
        sys.stdout.buffer.flush()
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output_path(out) as part, part.open("wb") as file:
            encode(columns, file)
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written: {error.strerror}") from error


def as_dict(columns: Columns, sky_label: str | None) -> dict[str, Any]:
    """Return `columns` for scripts: an object for each row, with the names of the CSV's columns."""
    values = [column.tolist() for column in _typed(columns).values()]
    return {"sky": sky_label, "rows": [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]}


def _show(columns: Columns, console: Console, sky_label: str | None, most_rows: int) -> None:
    """Print one row as a comparison of devices; several as a table, beside the inputs in which they differ."""
    rows = next(iter(columns.values())).size
    if rows == 1:
        _compare({name: float(column[0]) for name, column in columns.items()}, console, sky_label)
        return
    if sky_label:
        _print(f"Under the sky: {sky_label}.\n", console)
    told = [name for name in _INPUT_COLUMNS if name in columns and np.ptp(columns[name]) > 0.0] or ["phi_deg"]
    ordered = told + [name for name in columns if name not in {*told, "simulated"}]
    texts = [[name, *(_number(name, value) for value in columns[name][:most_rows])] for name in ordered]
    _print_aligned(list(zip(*texts, strict=True)), console, keys=len(told))
    if rows > most_rows:
        _print(f"and {pluralise(rows - most_rows, 'row')} more: --format csv writes them all", console)
    _print("\n" + _LEGEND, console)
    if sky_label:
        _print("..._sky: the same under that sky.", console)


def _compare(row: dict[str, float], console: Console, sky_label: str | None) -> None:
    when = f"day {row['n']:.0f}" if "n" in row else "the year"
    _print(f"Latitude {row['phi_deg']:zg} deg, {when}, in theory:", console)
    _print("constant beam from sunrise to sunset, no atmosphere.", console)
    titles: tuple[str, ...] = ("against", "tilt", "azimuth", "K", "dual gains", "over static")
    if sky_label:
        _print(f"Under the sky: {sky_label}.", console)
        titles = (*titles, "dual gains (sky)", "over static (sky)")
    lines = [_device(row, device, sky_label) for device in Device if _RATIO[device] in row]
    _print_aligned([titles, *lines], console)
    for name, value in row.items():
        if name.endswith(("_abs", "_min")) or "_eq" in name or "_script" in name:
            told = f"{value:z.6g}" if np.isfinite(value) else "not defined here"
            _print(f"{_in_words(name)}: {told}", console)


def _in_words(name: str) -> str:
    """Return in words what a column of the CSV is, with its name."""
    quantity, _, source = name.rpartition("_")
    if name == "K_DS_abs":
        return "dual axis over a static panel that is lit from both sides (K_DS_abs)"
    if source.startswith("eq"):
        return f"{quantity} by the paper's equation ({source[2:]}) as printed ({name})"
    if source == "min":
        return f"least of the year by the paper's script {quantity[-1]} ({name})"
    return f"{quantity} by the paper's script {source[-1]} ({name})"


def _print_aligned(lines: list[tuple[str, ...]], console: Console, *, keys: int = 1) -> None:
    for line in table(lines, keys=keys):
        _print(line, console)


def _print(text: str, console: Console) -> None:
    """Print a line as it is: neither wrapped nor cut where the terminal is narrow."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _device(row: dict[str, float], device: Device, sky_label: str | None) -> tuple[str, ...]:
    ratio = _RATIO[device]
    tilt = row.get(f"beta_{device}_deg", row.get("beta_deg", np.nan))
    tilt = abs(tilt) if device is Device.VERTICAL else tilt
    azimuth = "sun" if device is Device.VERTICAL else f"{row['lambda_deg']:zg}"
    cells = [_NAMES[device], f"{tilt:z.1f}", azimuth, _ratio(row[ratio]), _percent(row[ratio] - 1.0)]
    suffixes = ("", "_sky") if sky_label else ("",)
    for suffix in suffixes:
        if suffix:
            cells.append(_percent(row[ratio + suffix] - 1.0))
        eta = _ETA.get(device, "") + suffix
        cells.append(_percent(row[eta]) if eta in row else "")
    return tuple(cells)


def _ratio(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else "-"


def _percent(share: float) -> str:
    return f"{signed(100.0 * share, 1)} %" if np.isfinite(share) else "-"


def _number(name: str, value: float) -> str:
    # A search for the best tilt may end some 1e-15 deg beside zero.
    if np.isnan(value):
        return "-"
    value = 0.0 if abs(value) < _SHOWN_AS_ZERO else value
    return f"{value:.0f}" if name == "n" else f"{value:.6g}" if name.endswith("_deg") else f"{value:.5g}"


def _csv(columns: Columns, file: BinaryIO) -> None:
    file.write((",".join(columns) + "\n").encode())
    rows = next(iter(columns.values())).size
    typed = list(_typed(columns).values())
    for begin in range(0, rows, _CSV_BLOCK_ROWS):
        texts = [map(_cell, column[begin : begin + _CSV_BLOCK_ROWS].tolist()) for column in typed]
        file.write("".join(",".join(row) + "\n" for row in zip(*texts, strict=True)).encode())


def _cell(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _typed(columns: Columns) -> dict[str, NDArray[Any]]:
    return {name: column.astype(np.int64) if name == "n" else column for name, column in columns.items()}


def _parquet(columns: Columns, file: BinaryIO) -> None:
    import pyarrow as pa  # noqa: PLC0415 - half a second that the other formats need not wait for
    from pyarrow import parquet  # noqa: PLC0415 - as above

    parquet.write_table(pa.table(_typed(columns)), file)
