"""The bias between two measuring chains: found while both trackers lay flat, and kept in a small JSON file."""

import json
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.studies.compare.pairs import Pairs
from solar.agreement import Agreement, agreement
from solar.compare import ChainBias, fit_chain_bias, lies_flat

LEAST_PAIRS = 100
# At lower power a chain measures only its own noise.
LEAST_W = 1.0
_FORMAT = "heliocube chain bias 1"
# The file's names for the fields of `Agreement`, in their order.
_AGREEMENT_KEYS = ("count", "mbe_w", "rmbe_pct", "mae_w", "rmae_pct")


@dataclass(frozen=True, slots=True)
class Fit:
    """The fit of a bias: what was fitted to what, and how well.

    Attributes
    ----------
    names
        The tracker whose power is corrected, and the tracker that is its reference.
    bias
        The polynomial.
    start_utc_s, end_utc_s
        Instants of the first and the last pair.
    before, after
        Agreement of the corrected tracker's power with the other's, before and after, over the pairs of the fit itself.
    simulated
        Whether any of these pairs was simulated; False for files that do not tell.
    """

    names: tuple[str, str]
    bias: ChainBias
    start_utc_s: float
    end_utc_s: float
    before: Agreement
    after: Agreement
    simulated: bool = False


def flat_pairs(pairs: Pairs, start: datetime | None = None, end: datetime | None = None) -> Pairs:
    """Return the pairs from `start` up to `end` with power while both lay flat; `UserError` if they are too few.

    Where poses are not known, both are taken to lie flat if `start` or `end` is given.
    """
    low = -np.inf if start is None else start.timestamp()
    high = np.inf if end is None else end.timestamp()
    said = start is not None or end is not None
    chosen = (pairs.utc_s >= low) & (pairs.utc_s < high)
    for side in (pairs.cube, pairs.chrono):
        unknown = ~(np.isfinite(side.a_deg) & np.isfinite(side.b_deg))
        chosen &= lies_flat(side.a_deg, side.b_deg) | (unknown & said)
        chosen &= side.pmpp_w >= LEAST_W
    count = int(chosen.sum())
    if count < LEAST_PAIRS:
        poses = np.isfinite(pairs.cube.b_deg) & np.isfinite(pairs.chrono.b_deg)
        remedy = (
            "let both lie flat (law flat) for some days, and give those measurements"
            if poses.any() or said
            else "the measurements have no a_deg and b_deg: name the time at which both lay flat with --from and --to"
        )
        raise UserError(
            f"there is no period in which {pairs.names[0]} and {pairs.names[1]} both lay flat with {LEAST_W:g} W or"
            f" more ({count} pairs, {LEAST_PAIRS} are needed): {remedy}"
        )
    return pairs.select(chosen)


def fit(flat: Pairs) -> Fit:
    """Fit the bias on pairs of trackers that lay alike."""
    power, reference = flat.cube.pmpp_w, flat.chrono.pmpp_w
    try:
        bias = fit_chain_bias(power, reference)
    except ValueError as error:
        raise UserError(f"the bias cannot be fitted: {error}; measure in changing light") from None
    return Fit(
        names=flat.names,
        bias=bias,
        start_utc_s=float(flat.utc_s[0]),
        end_utc_s=float(flat.utc_s[-1]),
        before=agreement(power, reference),
        after=agreement(bias.corrected(power), reference),
        simulated=flat.simulated,
    )


def as_text(found: Fit) -> str:
    """Return the fit in lines for people."""
    bias, (cube, chrono) = found.bias, found.names
    lines = [
        (
            f"{found.before.pairs} pairs from {iso_utc(found.start_utc_s)[:19]}Z to {iso_utc(found.end_utc_s)[:19]}Z,"
            f" {bias.lowest_w:.0f} to {bias.highest_w:.0f} W"
        ),
        (
            f"{chrono} = {bias.constant_w:+z.4f} W {bias.linear:+z.5f} P {bias.quadratic_per_w:+.3e} P^2"
            f" for a power P of {cube}"
        ),
        f"{'':8}{'MBE/W':>9}{'rMBE/%':>9}{'MAE/W':>9}{'rMAE/%':>9}",
    ]
    for name, one in (("before", found.before), ("after", found.after)):
        lines.append(f"{name:8}{one.mbe:z9.3f}{one.rmbe_percent:z9.2f}{one.mae:9.3f}{one.rmae_percent:9.2f}")
    return "\n".join(lines) + "\n"


def write(found: Fit, path: Path) -> None:
    """Write the fit as JSON; `UserError` if the file cannot be written."""
    content = {
        "format": _FORMAT,
        "corrects": found.names[0],
        "reference": found.names[1],
        **asdict(found.bias),
        "from": iso_utc(found.start_utc_s),
        "to": iso_utc(found.end_utc_s),
        "before": _content(found.before),
        "after": _content(found.after),
        "simulated": found.simulated,
    }
    try:
        replace_file(path, json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise UserError(f"--out: {path} cannot be written: {error.strerror}") from None


def read(path: Path) -> Fit:
    """Return a fit from its file; `UserError` for a file that is no fit."""
    if path.is_dir():
        raise UserError(f"--bias: {path} is a folder: name the file in it that 'heliocube compare fit' wrote")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"--bias: there is no file {path}; 'heliocube compare fit' writes it") from None
    except OSError as error:
        raise UserError(f"--bias: {path} cannot be read: {error.strerror}") from None
    except ValueError:
        content = None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise UserError(f"--bias: {path} was not written by 'heliocube compare fit': name the file that it wrote")
    try:
        return _fit_of(content)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"--bias: {path} is damaged ({error}): write it again with 'heliocube compare fit'") from None


def _fit_of(content: dict[str, Any]) -> Fit:
    keys = ("constant_w", "linear", "quadratic_per_w", "lowest_w", "highest_w")
    numbers = [float(content[key]) for key in keys]
    if not np.isfinite(numbers).all():
        raise ValueError("a coefficient is not a number")
    start, end = (datetime.fromisoformat(content[key]).timestamp() for key in ("from", "to"))
    names = (str(content["corrects"]), str(content["reference"]))
    before, after = (_statistics(content[name]) for name in ("before", "after"))
    return Fit(
        names=names,
        bias=ChainBias(*numbers),
        start_utc_s=start,
        end_utc_s=end,
        before=before,
        after=after,
        simulated=bool(content.get("simulated", False)),
    )


def _statistics(content: dict[str, Any]) -> Agreement:
    pairs, *numbers = (float(content[key]) for key in _AGREEMENT_KEYS)
    if not np.isfinite([pairs, *numbers]).all():
        raise ValueError("a statistic is not a number")
    return Agreement(int(pairs), *numbers)


def _content(statistics: Agreement) -> dict[str, float]:
    return dict(zip(_AGREEMENT_KEYS, statistics, strict=True))
