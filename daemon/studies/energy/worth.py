"""What the laws earn and wear in money: the thrift that pays best, from the price of energy and the life of a drive."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from textwrap import wrap
from typing import Any

import numpy as np

from daemon.studies.energy.benchmark import EnergyRow
from daemon.studies.energy.names import BOUND, FIXED
from daemon.studies.text_table import WIDTH, table
from solar.energy import DaylightWeather
from solar.ephemeris import DAY_S, Site, sun_position
from solar.frames import Array

_YEAR_DAYS = 365.25
_LONGEST_NIGHT_S = _YEAR_DAYS / 2.0 * DAY_S
_HEADS = ("law", "energy/year", "wear/year", "left/year", "drive lasts")


@dataclass(frozen=True, slots=True)
class Prices:
    """What energy and wear are worth, in one currency.

    Attributes
    ----------
    peak_kw
        Power of the modules on the tracker at 1 kW/m2; it turns insolation [kWh/m2] into energy [kWh] without losses.
    per_kwh
        Price of energy.
    drive
        Price of new drives for both axes, with the work of changing them.
    life_deg
        Travel, A and B added, after which the drives are changed.
    """

    peak_kw: float
    per_kwh: float
    drive: float
    life_deg: float


@dataclass(frozen=True, slots=True)
class Worth:
    """A law's mean year in money.

    Attributes
    ----------
    energy, wear
        What the modules' energy sells for, and what the travel costs in wear of the drives.
    drive_years
        How long the drives last.
    """

    sky: str
    law: str
    energy: float
    wear: float
    drive_years: float

    @property
    def net_value(self) -> float:
        """The price of the energy less the cost of wear."""
        return self.energy - self.wear


def years_known(utc_s: Array, weather: DaylightWeather) -> float:
    """Return how many mean years the weather at these rising instants [s] covers.

    Days with light count as `DaylightWeather.whole_days` says. A day on which the sun does not rise counts too, if its
    noon is between the instants. A gap of more than half a year is no polar night: there are no records of that time.
    """
    stretches = np.split(utc_s, np.flatnonzero(np.diff(utc_s) > _LONGEST_NIGHT_S) + 1)
    sunless = sum(_count_sunless_days(float(stretch[0]), float(stretch[-1]), weather.site) for stretch in stretches)
    return (weather.whole_days() + sunless) / _YEAR_DAYS


def _count_sunless_days(start_utc_s: float, end_utc_s: float, site: Site) -> int:
    east_s = site.longitude_deg * 240.0
    first, last = ((at_s + east_s) / DAY_S - 0.5 for at_s in (start_utc_s, end_utc_s))
    noons_utc_s = (np.arange(np.ceil(first), np.floor(last) + 1.0) + 0.5) * DAY_S - east_s
    return int(np.count_nonzero(sun_position(noons_utc_s, *site).elevation_deg <= 0.0))


def worths(rows: Sequence[EnergyRow], whole_days: float, years: float, prices: Prices) -> list[Worth]:
    """Return what each law is worth; the bound, which is no tracker, is left out.

    Parameters
    ----------
    rows
        Rows of the benchmark.
    whole_days
        How many days they cover, by `DaylightWeather.whole_days`.
    years
        How many years they cover, by `years_known`.
    prices
        Prices of energy and drives. The way back to the night position counts as wear like any other.
    """
    return [_worth(row, whole_days, years, prices) for row in rows if row.law != BOUND]


def as_text(found: Sequence[Worth], years: float, prices: Prices) -> str:
    """Return the tables of all skies as text for people; `years` as for `worths`."""
    assumed = (
        f"In money, scaled to a year from {years * _YEAR_DAYS:.1f} days of records, whatever their season:"
        f" {prices.peak_kw:g} kW of modules at {prices.per_kwh:g} per kWh, without their losses;"
        f" drives for {prices.drive:,g} last {prices.life_deg:,.0f} deg of travel, including the way back at night."
    )
    lines = ["", *wrap(assumed, WIDTH)]
    for sky in dict.fromkeys(each.sky for each in found):
        of_sky = [each for each in found if each.sky == sky]
        best = max(of_sky, key=lambda each: each.net_value)
        lines += ["", f"sky {sky}: most is left by {best.law}", *table([_HEADS, *map(_cells, of_sky)])]
    return "\n".join(lines) + "\n"


def as_dict(found: Sequence[Worth], prices: Prices) -> dict[str, Any]:
    """Return what each law is worth, for scripts."""
    return {"prices": asdict(prices), "rows": [asdict(each) | {"left": each.net_value} for each in found]}


def _worth(row: EnergyRow, whole_days: float, years: float, prices: Prices) -> Worth:
    # A plane that is fixed has no drive, and no travel.
    per_day_deg = 0.0 if row.law.startswith(FIXED) else row.travel_deg_per_day + row.return_deg_per_day
    travel_deg = per_day_deg * whole_days / years
    return Worth(
        sky=row.sky,
        law=row.law,
        energy=row.energy_kwh_m2 * prices.peak_kw * prices.per_kwh / years,
        wear=travel_deg / prices.life_deg * prices.drive,
        drive_years=prices.life_deg / travel_deg if travel_deg > 0.0 else math.inf,
    )


def _cells(each: Worth) -> list[str]:
    lasts = "-" if math.isinf(each.drive_years) else f"{each.drive_years:.1f} years"
    return [each.law, f"{each.energy:.2f}", f"{each.wear:.2f}", f"{each.net_value:.2f}", lasts]
