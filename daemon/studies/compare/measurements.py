"""Measured powers of trackers: one row per tracker and instant, in memory and in tables."""

from pathlib import Path
from typing import NamedTuple

from daemon.store.tables import Column, Format, TableWriter

REQUIRED = ("time", "tracker", "pmpp_w")
OPTIONAL = ("irradiance_w_m2", "a_deg", "b_deg", "module_temp_degc", "ghi_w_m2", "dhi_w_m2")
SIMULATED = "simulated"


class Measurement(NamedTuple):
    """The power of one tracker's module at one instant, and what is known of the circumstances; NaN for unknown.

    Attributes
    ----------
    time
        When it was measured [s UTC].
    tracker
        Name of the tracker.
    pmpp_w
        Power at the maximum power point.
    irradiance_w_m2
        Irradiance on the module's plane.
    a_deg, b_deg
        Where the tracker truly stood.
    module_temp_degc
        Temperature of the module.
    ghi_w_m2, dhi_w_m2
        Global and diffuse horizontal irradiance.
    simulated
        Whether it comes from a model or a bench and not from a module.
    """

    time: float
    tracker: str
    pmpp_w: float
    irradiance_w_m2: float
    a_deg: float
    b_deg: float
    module_temp_degc: float
    ghi_w_m2: float
    dhi_w_m2: float
    simulated: bool = False


_COLUMNS = [
    Column("time", "time", "time"),
    Column("tracker", "tracker", "text"),
    *[Column(name, name, "float") for name in ("pmpp_w", *OPTIONAL)],
    Column(SIMULATED, SIMULATED, "bool"),
]


def writer(directory: Path, table_format: Format, *, force: bool) -> TableWriter:
    """Return a writer of measurements to ``powers.csv`` or ``powers.parquet`` in a folder; raises `UserError`."""
    return TableWriter(directory, table_format, {Measurement: ("powers", _COLUMNS)}, force=force)
