"""After a sleep of the machine only later readings and decisions may move a tracker; the watch finds earlier ones."""

import math
from types import SimpleNamespace

import pytest

from daemon.base.records import Mode
from daemon.config.settings import Settings
from daemon.studies.campaign.watch.decided import Decided
from daemon.tracker.wishes import Wish, Wishes
from solar.frames import Angles

WOKE_S = 1000.0


def sent(
    at_s,
    *,
    seen_s,
    decided_s,
    coverage=0.1,
    silent_s=math.inf,
    mode=Mode.TRACKING,
    slept_s=3600.0,
    goto_deg=None,
    aim_deg=(0.0, 60.0),
):
    """Send a target after a sleep; return what is found wrong with it."""
    found = []
    irradiances = SimpleNamespace(coverage=coverage)
    decision = SimpleNamespace(time_monotonic_s=decided_s, irradiances=irradiances, target=Angles(*aim_deg))
    hold = None if goto_deg is None else Wish(why="test", by="ana", since_utc_s=900.0, goto_deg=goto_deg)
    wishes = Wishes(hold=hold)
    control = SimpleNamespace(mode=mode, wishes=wishes, state=SimpleNamespace(scan_age_s=1.0, decision=decision))
    mount = SimpleNamespace(
        control=control,
        motion=SimpleNamespace(telemetry=SimpleNamespace(time_monotonic_s=seen_s), last_move_started_s=0.0),
        settings=Settings.model_validate({"windows": {"mean_s": 60.0}}),
        wind_silent_since_s=silent_s,
        is_served=True,
        truth=lambda: Angles(0.0, 60.0),
    )
    watch = Decided(lambda promise, text: found.append(f"{promise}: {text}"))
    watch.wakes(mount, slept_s, WOKE_S)
    watch.check(mount, (0.0, 60.0), at_s, 0.0)
    return " ".join(found)


def sent_first_by_night(second_move_s):
    """Send a target after a sleep by night, and again while tracking; return what is found wrong with it."""
    found = []
    decision = SimpleNamespace(time_monotonic_s=990.0, irradiances=None, target=Angles(0.0, 60.0))
    state = SimpleNamespace(scan_age_s=1.0, decision=decision)
    mount = SimpleNamespace(
        control=SimpleNamespace(mode=Mode.NIGHT, wishes=Wishes(), state=state),
        motion=SimpleNamespace(telemetry=SimpleNamespace(time_monotonic_s=1030.0), last_move_started_s=1035.0),
        settings=Settings(),
        wind_silent_since_s=math.inf,
        is_served=True,
        truth=lambda: Angles(0.0, 60.0),
        clock=SimpleNamespace(utc=lambda: 0.0),
    )
    watch = Decided(lambda promise, text: found.append(f"{promise}: {text}"))
    watch.wakes(mount, 3600.0, WOKE_S)
    watch.check(mount, (0.0, 60.0), 1037.0, 0.0)
    mount.control.mode, mount.motion.last_move_started_s = Mode.TRACKING, second_move_s
    watch.check(mount, (0.0, 60.0), 1080.0, 0.0)
    return " ".join(found)


@pytest.mark.parametrize(("second_move_s", "is_breach"), [(1035.0, False), (1079.5, True)])
def test_the_second_try_of_a_move_by_night_is_allowed_and_a_new_move_by_an_old_decision_is_not(
    second_move_s, is_breach
):
    assert ("was decided before it" in sent_first_by_night(second_move_s)) is is_breach


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"seen_s": 1040.0, "decided_s": 1040.0, "coverage": 0.7}, ""),
        ({"seen_s": 999.9, "decided_s": 1040.0}, "slept: (0.0, 60.0) is sent 40.0 s after a sleep, and nobody has lo"),
        (
            {"seen_s": 1040.0, "decided_s": 990.0},
            "slept: (0.0, 60.0) is sent in mode tracking 40.0 s after a sleep, an",
        ),
        # The second try of a move that was ordered by mode night.
        ({"seen_s": 1040.0, "decided_s": 990.0, "aim_deg": (10.0, 50.0)}, ""),
        ({"seen_s": 1040.0, "decided_s": 1030.0, "coverage": 0.9}, "slept: (0.0, 60.0) is sent 40.0 s after a sleep b"),
        (
            {"seen_s": 1040.0, "decided_s": 1040.0, "silent_s": 990.0},
            "and the wind has not been heard since",
        ),
        ({"seen_s": 1040.0, "decided_s": 1040.0, "silent_s": 1010.0}, ""),
        ({"seen_s": 1040.0, "decided_s": 990.0, "mode": Mode.STOW, "silent_s": 990.0}, ""),
        ({"seen_s": 999.9, "decided_s": 990.0, "slept_s": 3.0}, ""),
        (
            {"seen_s": 1040.0, "decided_s": 990.0, "mode": Mode.HOLD, "goto_deg": (0.0, 40.0)},
            "slept: (0.0, 60.0) is sent 40.0 s after a sleep, by a goto of before it that had not arrived",
        ),
        ({"seen_s": 1040.0, "decided_s": 990.0, "mode": Mode.HOLD, "goto_deg": (0.0, 61.0)}, ""),
        ({"seen_s": 1040.0, "decided_s": 990.0, "mode": Mode.HOLD, "goto_deg": (0.0, 40.0), "slept_s": 3.0}, ""),
    ],
)
def test_the_watch_notices_a_target_after_a_sleep_that_goes_by_anything_from_before_it(what, said):
    found = sent(1040.0, **what)
    assert said in found
    assert bool(found) is bool(said)
