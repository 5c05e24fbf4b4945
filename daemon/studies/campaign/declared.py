"""What is declared for each fault alone: the mode, how soon, what a person has to say, and how soon it works again.

The times follow from the settings' defaults: 0.5 s between two polls of the positioner, 5 s between two decisions, 2 s
until silence is a loss, 60 s without good readings until fallback, 10 min until a move that failed is tried again.
"""

from daemon.base.records import Mode
from daemon.rigs.campaign.faults import FAULTS
from daemon.studies.campaign.draw import ROTATOR_FAULT_SPANS
from daemon.studies.campaign.drills import FALLBACK, FAULT, HOLD, STOW, Drill, Phase

_SHORT_S, _OUTAGE_S, _DARK_S = 10.0, 70.0, 400.0
_POLLED_S, _SWITCH_S, _SILENT_S = 1.0, 1.5, 3.5
_NEXT_MOVE_S, _STALLED_S, _BOTH_AXES_S = 45.0, 20.0, 60.0
_NO_READINGS_S, _FROZEN_S = 70.0, 100.0
_DECIDES_S, _WIND_STALE_S = 6.0, 310.0
_STARTS_S = 45.0
_AT_ONCE_S, _RECONNECTS_S, _READS_S, _HOMES_S = 10.0, 15.0, 60.0, 300.0
_RETRIES_S, _CALM_S, _AGREES_S = 620.0, 150.0, 1800.0
_TRACKING = (Mode.TRACKING,)
_GOES_ON: tuple[Mode, ...] = ()
_BY_ITSELF: tuple[str, ...] = ()
# The first reference run finds the count wrong and says so; the second one ends well.
_CLEAR, _AUTO, _HOME, _HOME_TWICE = ("clear",), ("auto",), ("home",), ("clear", "home", "home")
_BOTH: tuple[Phase, ...] = ("at rest", "in mid-move")
_REST: tuple[Phase, ...] = ("at rest",)
_MOVE: tuple[Phase, ...] = ("in mid-move",)
_BUTTONS = ("button", "button_in", "buttons_both")
_REPLIES = ("meter_garbled", "meter_cut", "meter_mute")

_Row = tuple[str, tuple[float, ...], float, tuple[Mode, ...], float, tuple[str, ...], float, tuple[Phase, ...]]

_ROWS: tuple[_Row, ...] = (
    ("unplug_positioner", (), _OUTAGE_S, FAULT, _POLLED_S, _BY_ITSELF, _RECONNECTS_S, _BOTH),
    ("positioner_silent", (), _OUTAGE_S, FAULT, _SILENT_S, _BY_ITSELF, _RECONNECTS_S, _BOTH),
    ("deaf", (), _OUTAGE_S, FAULT, _NEXT_MOVE_S, _BY_ITSELF, _RETRIES_S, _REST),
    ("deaf", (), _OUTAGE_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _MOVE),
    ("gone", (), _OUTAGE_S, FAULT, _POLLED_S, _BY_ITSELF, _RECONNECTS_S, _BOTH),
    ("stopless", (), _OUTAGE_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
    ("undervoltage", (), _OUTAGE_S, FAULT, _NEXT_MOVE_S, _BY_ITSELF, _RETRIES_S, _REST),
    ("undervoltage", (), _OUTAGE_S, FAULT, _STALLED_S, _BY_ITSELF, _RETRIES_S, _MOVE),
    ("own_tracking", (), _OUTAGE_S, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH),
    ("slave_mode", (), _OUTAGE_S, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH),
    ("slave_standby", (), _OUTAGE_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
    ("re_reference", (), 0.0, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH),
    *((name, (), _SHORT_S, HOLD, _POLLED_S, _AUTO, _AT_ONCE_S, _BOTH) for name in _BUTTONS),
    *((f"{axis}_hall_loss", (), _OUTAGE_S, FAULT, _BOTH_AXES_S, _HOME_TWICE, _HOMES_S, _MOVE) for axis in "ab"),
    *((f"{axis}_cable", (), _SHORT_S, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH) for axis in "ab"),
    *((f"{axis}_switch_closed", (), _SHORT_S, FAULT, _SWITCH_S, _CLEAR, _AT_ONCE_S, _BOTH) for axis in "ab"),
    *((f"{axis}_switch_open", (), _OUTAGE_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH) for axis in "ab"),
    ("a_ignores_targets", (), _OUTAGE_S, FAULT, _NEXT_MOVE_S, _BY_ITSELF, _RETRIES_S, _REST),
    *((f"{axis}_overcurrent", (), 0.0, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH) for axis in "ab"),
    *((f"{axis}_pulse_loss", (), 0.0, FAULT, _POLLED_S, _HOME, _HOMES_S, _BOTH) for axis in "ab"),
    *((f"{axis}_destination", (), 0.0, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH) for axis in "ab"),
    ("a_slip", (), 0.0, FAULT, _SWITCH_S, _HOME_TWICE, _HOMES_S, _MOVE),
    ("b_slip", (), 0.0, FAULT, _SWITCH_S, _HOME_TWICE, _HOMES_S, _REST),
    ("reset_position_kept", (), 0.0, FAULT, _POLLED_S, _CLEAR, _AT_ONCE_S, _BOTH),
    ("reset_position_lost", (), 0.0, FAULT, _POLLED_S, _HOME, _HOMES_S, _BOTH),
    ("wind", (20.0,), _OUTAGE_S, STOW, _DECIDES_S, _BY_ITSELF, _CALM_S, _BOTH),
    ("wind_silent", (), _DARK_S, STOW, _WIND_STALE_S, _BY_ITSELF, _CALM_S, _BOTH),
    ("clock_step", (3600.0,), _DARK_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
    ("unplug_multiplexer", (), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _READS_S, _BOTH),
    ("unplug_voltmeter", (), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _READS_S, _BOTH),
    ("meter_frozen", (), _DARK_S, FALLBACK, _FROZEN_S, _BY_ITSELF, _READS_S, _BOTH),
    ("meter_late", (6.0,), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _READS_S, _BOTH),
    *((name, (1,), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST) for name in _REPLIES),
    ("meter_restart", (), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST),
    ("switch_fails", (2,), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST),
    ("switch_reset", (), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST),
    ("face_stuck", (0, 9.9), _DARK_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
    ("face_noise", (1.0,), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _AGREES_S, _REST),
    ("bridge_lost", (), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _READS_S, _BOTH),
    ("bridge_late", (40.0,), _DARK_S, FALLBACK, _NO_READINGS_S, _BY_ITSELF, _READS_S, _BOTH),
    ("bridge_replayed", (), _DARK_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST),
    ("bridge_forged", (30,), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _REST),
    ("disk_full", (), _OUTAGE_S, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
    ("kill", (), _SHORT_S, _TRACKING, _SHORT_S + _STARTS_S, _BY_ITSELF, _AT_ONCE_S + _STARTS_S, _BOTH),
    ("end", (), _SHORT_S, _TRACKING, _SHORT_S + _STARTS_S, _BY_ITSELF, _AT_ONCE_S + _STARTS_S, _BOTH),
    ("suspended", (60.0,), 0.0, FALLBACK, 61.0, _BY_ITSELF, 60.0 + _AT_ONCE_S, _BOTH),
    ("machine_sleeps", (900.0,), 0.0, _GOES_ON, 0.0, _BY_ITSELF, _AT_ONCE_S, _BOTH),
)  # fmt: skip

REASONS_WITHOUT_DRILL = {
    "switch_line_stuck": "without a self-test input it shows only in daylight, when the faces contradict each other",
    "face_shaded": "a face that stays in the shade reads too little, as under a cloud; this shows only after days",
    "b_ignores_targets": "shows at the next move of B, as `a_ignores_targets` does at the next move of A",
    "unit_wind": "acts only while the unit's own sun tracking is on, and the service switches that off",
    "unit_snow": "as `unit_wind`",
    "kill_torn": "as `kill`, but with a file that cannot be read, which leaves the reference in doubt",
}
"""Faults that have no row, and why."""


def declared_drills() -> tuple[Drill, ...]:
    """Return every drill, one for each fault and phase."""
    return tuple(
        Drill(
            fault=fault,
            value=value,
            lasts_s=lasts_s,
            mode=mode,
            within_s=within_s,
            commands=commands,
            recovery_s=recovery_s,
            phase=phase,
            positioner="rotctld" if fault in ROTATOR_FAULT_SPANS else "pozsol",
        )
        for fault, value, lasts_s, mode, within_s, commands, recovery_s, phases in _ROWS
        for phase in phases
    )


def faults_without_drill() -> set[str]:
    """Return the faults that are in no drill."""
    return set(FAULTS) - {row[0] for row in _ROWS}
