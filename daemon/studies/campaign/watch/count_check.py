"""Whether the unit's count is true, and whether the service doubts a count that is not."""

from collections.abc import Callable

from daemon.base.records import Mode
from daemon.rigs.campaign.plant import PlantTracker
from drivers.interfaces import AxisName
from solar.frames import Angles

COUNT_TOLERANCE_DEG = 0.02
WRONG_COUNT_DEG = 0.8
COUNT_CHECK_EVERY_S = 5.0
DOUBTS_WITHIN_S = 30.0


class CountCheck:
    """Compares the unit's count with the truth.

    Parameters
    ----------
    fails
        Called with a promise and a text.

    Attributes
    ----------
    excused
        A person, or a fault that nobody can see, answers for the unit's count.
    lost_s
        When a fault last made the unit lose its count. The unit then drives a standing axis back to where it was sent.
    wrong_s
        Since when the count has been wrong, or None.
    compared_s
        When count and truth were last compared.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self.excused = False
        self.lost_s = float("-inf")
        self.wrong_s: float | None = None
        self.compared_s = float("-inf")

    def is_count_true(self, mount: PlantTracker, axis: AxisName, at_deg: float, now_s: float) -> bool:
        """Tell whether the unit's count of an axis is the truth, to within `COUNT_TOLERANCE_DEG`."""
        return abs(mount.unit.shown_deg(axis, now_s) - at_deg) < COUNT_TOLERANCE_DEG

    def is_wrong(self, mount: PlantTracker, at: Angles, now_s: float) -> bool:
        """Tell whether the unit's count is not where the axes are."""
        shown = _shown_angles(mount, now_s)
        return max(abs(shown.a_deg - at.a_deg), abs(shown.b_deg - at.b_deg)) > WRONG_COUNT_DEG

    def check(self, mount: PlantTracker, at: Angles, now_s: float, since_s: float, *, blind: bool, live: bool) -> None:
        """Look every few seconds at axes that stand.

        Parameters
        ----------
        since_s
            Since when the service can know.
        blind
            Whether an axis gives no Hall pulses.
        live
            Whether the service is there and connected.
        """
        if now_s - self.compared_s < COUNT_CHECK_EVERY_S:
            return
        self.compared_s = now_s
        if not self.is_wrong(mount, at, now_s):
            self.wrong_s = None
            # A count that is slightly wrong at one angle may be wrong by a degree at another.
            true = self.is_count_true(mount, "a", at.a_deg, now_s) and self.is_count_true(mount, "b", at.b_deg, now_s)
            self.excused = self.excused and (blind or not true)
            return
        if self.wrong_s is None:
            self.wrong_s = now_s
        control = mount.control
        tracks = control.mode in (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT)
        late = now_s - max(self.wrong_s, since_s) > DOUBTS_WITHIN_S
        if tracks and late and not self.excused and mount.motion.doubt is None and live:
            text = f"the unit says {_shown_angles(mount, now_s)}, the truth is {at}; mode {control.mode}, no doubt"
            self._fails("believes-a-wrong-count", text)


def _shown_angles(mount: PlantTracker, now_s: float) -> Angles:
    return Angles(mount.unit.shown_deg("a", now_s), mount.unit.shown_deg("b", now_s))
