"""The campaign's plant, built for a schedule."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.file import override
from daemon.config.settings import Settings
from daemon.config.trackers import TrackerTable
from daemon.rigs.campaign.plant import UNIT_OWN_TARGET, Plant
from daemon.rigs.campaign.rig import ManualWeather
from daemon.rigs.campaign.taps import Witness
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles

_OWN_TARGET_EVERY_S = 300
_STOW_APART_DEG = 5.0


def plant_settings(
    *,
    law: str,
    rehome: str,
    positioner: str,
    trackers: int,
    chosen: Mapping[Any, Mapping[str, Any]],
    directory: Path | None = None,
) -> Settings:
    """Return the settings of a plant's service.

    Parameters
    ----------
    law, rehome
        As in the settings.
    positioner
        Driver of the positioners.
    trackers
        How many there are.
    chosen
        Other settings that differ from the defaults, by section and key; ``positioner`` for ``instruments.positioner``.
    directory
        Where the service keeps its files.

    Raises
    ------
    ConfigError
        The settings are not valid.
    """
    settings = Settings.model_validate(
        {
            "instruments": {"positioner": {"driver": positioner}},
            "bridge": {"listen": "127.0.0.1:0", "send_to": ()},
            "law": {"driver": law},
            "motion": {"rehome": rehome},
            "safety": {"stow_at_least_s": 120.0},
            "store": {"directory": directory},
        }
    )
    if chosen:
        changes: dict[str, Mapping[str, Any]] = {
            name: values for name, values in chosen.items() if name != "positioner"
        }
        if own := chosen.get("positioner"):
            changes["instruments"] = {"positioner": {"driver": positioner, **own}}
        settings = override(settings, changes)
    return settings.model_copy(update={"tracker": _tables(trackers)})


def build_plant(
    loop: VirtualTimeLoop,
    start: datetime,
    settings: Settings,
    witnesses: Sequence[Witness],
    *,
    synchronous: bool,
    sky_w_m2: tuple[float, float],
) -> Plant:
    """Return a plant, its service not yet started.

    Parameters
    ----------
    loop, start, settings, witnesses
        As for `Plant`.
    synchronous
        Whether the unit drives both axes at once.
    sky_w_m2
        DNI and DHI.
    """
    setup = Setup(synchronous=synchronous, own_target=_own_target, wind_stow=UNIT_OWN_TARGET, snow_stow=UNIT_OWN_TARGET)
    return Plant(loop, settings, start, ManualWeather(*sky_w_m2), setup, witnesses)


def _tables(trackers: int) -> tuple[TrackerTable, ...]:
    """Return a table for each of several trackers; their stow positions differ, so that a misdirected order shows."""
    if trackers == 1:
        return ()
    places = (_STOW_APART_DEG * place for place in range(trackers))
    return tuple(
        TrackerTable.model_validate({"name": f"t{number}", "safety": {"stow_a_deg": stow_a_deg}})
        for number, stow_a_deg in enumerate(places)
    )


def _own_target(now_s: float) -> Angles:
    """Return where the unit's own tracking points; it moves on every 5 min."""
    return UNIT_OWN_TARGET if int(now_s // _OWN_TARGET_EVERY_S) % 2 else Angles(-20.0, 60.0)
