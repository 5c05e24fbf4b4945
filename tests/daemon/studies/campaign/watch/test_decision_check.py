"""After a sleep of the machine only later readings and decisions may move a tracker; the watch finds earlier ones."""

import math
from types import SimpleNamespace

import pytest

from daemon.base.records import Mode
from daemon.config.settings import Settings
from daemon.studies.campaign.watch.decision_check import DecisionCheck
from daemon.tracker.wishes import Wish, Wishes
from solar.frames import Angles

WOKE_S = 1000.0


class Woken:
    """A tracker whose machine has slept until `WOKE_S`, and what the watch finds wrong with targets that are sent."""

    def __init__(
        self,
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
        irradiances = SimpleNamespace(coverage=coverage)
        decision = SimpleNamespace(time_monotonic_s=decided_s, irradiances=irradiances, target=Angles(*aim_deg))
        hold = None if goto_deg is None else Wish(why="test", by="ana", since_utc_s=900.0, goto_deg=goto_deg)
        state = SimpleNamespace(scan_age_s=1.0, decision=decision)
        self.mount = SimpleNamespace(
            control=SimpleNamespace(mode=mode, wishes=Wishes(hold=hold), state=state),
            motion=SimpleNamespace(telemetry=SimpleNamespace(time_monotonic_s=seen_s), last_move_started_s=0.0),
            settings=Settings.model_validate({"windows": {"mean_s": 60.0}}),
            wind_silent_since_s=silent_s,
            is_served=True,
            truth=lambda: Angles(0.0, 60.0),
        )
        self.found = []
        self._watch = DecisionCheck(lambda promise, text: self.found.append(f"{promise}: {text}"))
        self._watch.note_wake_up(self.mount, slept_s, WOKE_S)

    def send(self, at_s, move_s=0.0):
        """Send a target, at first or again, in a move that began at `move_s`."""
        self.mount.motion.last_move_started_s = move_s
        self._watch.check(self.mount, (0.0, 60.0), at_s, 0.0)


@pytest.mark.parametrize(("second_move_s", "is_breach"), [(1035.0, False), (1079.5, True)])
def test_the_second_try_of_a_move_by_night_is_allowed_and_a_new_move_by_an_old_decision_is_not(
    second_move_s, is_breach
):
    tracker = Woken(seen_s=1030.0, decided_s=990.0, mode=Mode.NIGHT)
    tracker.send(1037.0, move_s=1035.0)
    tracker.mount.control.mode = Mode.TRACKING
    tracker.send(1080.0, move_s=second_move_s)
    assert ("was decided before it" in " ".join(tracker.found)) is is_breach


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
    tracker = Woken(**what)
    tracker.send(1040.0)
    found = " ".join(tracker.found)
    assert said in found
    assert bool(found) is bool(said)
