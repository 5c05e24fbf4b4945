"""Settings drawn from a seed: people change settings, so a promise has to hold with others than the defaults."""

from random import Random

from daemon.studies.campaign.schedule import SettingsOverrides

_CHANCE_OF_DEFAULTS = 0.3
_CHANCE_OF_CHANGE = 0.35
CHOICES: tuple[tuple[SettingsOverrides, ...], ...] = (
    (
        {"site": {"latitude_deg": -33.9}},
        {"site": {"latitude_deg": 4.0}},
        {"site": {"latitude_deg": 69.6}},
    ),
    (
        {"cube": {"scan_every_s": 2.0}},
        {"cube": {"scan_every_s": 10.0}, "safety": {"scan_stale_s": 25.0}},
        {"cube": {"scan_every_s": 20.0}, "safety": {"scan_stale_s": 60.0}},
        {"cube": {"scan_every_s": 60.0}, "safety": {"scan_stale_s": 150.0}},
    ),
    (
        {"windows": {"mean_s": 60.0, "decide_every_s": 60.0}},
        {"windows": {"mean_s": 300.0, "decide_every_s": 300.0}},
        {"windows": {"mean_s": 120.0, "decide_every_s": 1200.0, "minimum_coverage": 0.9}},
    ),
    (
        {
            "limits": {"a_min_deg": -35.0, "b_min_deg": 20.0, "b_max_deg": 85.0},
            "safety": {"stow_b_deg": 80.0, "night_b_deg": 82.0},
        },
        {"limits": {"a_max_deg": 46.0, "b_min_deg": 40.0}, "safety": {"snow_b_deg": 45.0, "snow_a_deg": -50.0}},
        {"safety": {"stow_a_deg": 10.0, "stow_b_deg": 70.0, "night_a_deg": 45.0, "night_b_deg": 20.0}},
    ),
    (
        {"motion": {"deadband_deg": 0.0, "minimum_interval_s": 0.0, "tolerance_deg": 0.5}},
        {"motion": {"deadband_deg": 3.0, "minimum_interval_s": 600.0, "tolerance_deg": 2.0}},
    ),
    (
        {"motion": {"travel_per_day_deg": 120.0}},
        {"motion": {"moves_per_day": 12}},
    ),
    (
        {"motion": {"attempts": 1, "retry_after_s": 120.0}},
        {"motion": {"attempts": 5, "retry_after_s": 1200.0}},
    ),
    (
        {"safety": {"fallback_after_s": 15.0, "keep_pose_s": 0.0}},
        {"safety": {"fallback_after_s": 300.0, "keep_pose_s": 900.0}},
    ),
    (
        {"safety": {"stow_wind_m_s": 8.0, "release_wind_m_s": 3.5, "stow_at_least_s": 20.0, "wind_stale_s": 30.0}},
        {"safety": {"stow_at_least_s": 3600.0, "wind_stale_s": 900.0}},
    ),
    (
        {"safety": {"night_below_w_m2": 50.0, "night_above_w_m2": 80.0, "night_highest_sun_deg": 20.0}},
        {"safety": {"night_below_w_m2": 0.5, "night_above_w_m2": 1.0, "night_highest_sun_deg": -3.0}},
    ),
    ({"cube": {"dark_correction": False}},),
    ({"law": {"shadow": "optimal"}},),
)
"""Groups of settings that belong together, each with several choices."""
AXIS_VARIANTS: tuple[SettingsOverrides, ...] = (
    {"positioner": {"a_axis": {"sense": "lowers", "low_deg": 52.0, "apex_deg": 90.0}, "status_layout": "stm"}},
    {
        "positioner": {
            "a_axis": {"low_deg": -53.0, "arm_1_mm": 280.0, "arm_2_mm": 340.0, "apex_deg": 85.0, "holder_mm": 20.0},
            "b_axis": {"low_deg": 12.0, "arm_1_mm": 400.0, "arm_2_mm": 250.0, "apex_deg": 45.0, "zero_offset": 2.5},
        }
    },
    {"positioner": {"b_axis": {"sense": "lowers", "low_deg": 93.0, "apex_deg": 130.0}}},
    {"positioner": {"position_unit": "deg"}, "motion": {"tolerance_deg": 1.2}},
    {"positioner": {"position_unit": "impulse"}},
    {
        "positioner": {
            "position_unit": "impulse",
            "a_axis": {"impulses_per_deg": 300.0},
            "b_axis": {"impulses_per_deg": 240.0, "zero_offset": 100.0},
        }
    },
)
"""Ways to build the axes of a unit."""


def draw_settings(seed: int, law: str, positioner: str) -> SettingsOverrides:
    """Return the settings of a seed that are not the defaults, by section and key; none for three seeds of ten.

    Parameters
    ----------
    seed
        The same seed has the same settings, whatever else is drawn from it.
    law
        The law that points the tracker: it is not run in its own shadow.
    positioner
        Driver of the positioner: a rotator is not built in other ways.
    """
    random = Random(f"{seed} settings")  # noqa: S311 - reproducibility is the point; nothing secret depends on it
    chosen: SettingsOverrides = {}
    if random.random() < _CHANCE_OF_DEFAULTS:
        return chosen
    for ways in (*CHOICES, AXIS_VARIANTS) if positioner == "pozsol" else CHOICES:
        if random.random() >= _CHANCE_OF_CHANGE:
            continue
        for section, values in random.choice(ways).items():
            chosen.setdefault(section, {}).update(values)
    if chosen.get("law", {}).get("shadow") == law:
        del chosen["law"]
    return chosen
