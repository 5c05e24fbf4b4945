"""Finding faces of the cube that cannot be true, without a self-test: against each other, the sun and a clear sky."""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch
from daemon.base.records import FACES
from daemon.base.sleeps import SleepGauge
from daemon.config.sections import CubeSettings, SiteSettings
from daemon.cube.contradictions import MINUTES, Contradictions
from daemon.cube.told_faces import in_a_row, kept_since, reads, since_each
from solar.ephemeris import SunDirection
from solar.faces.contradiction import misfits
from solar.faces.jumps import jumps
from solar.faces.plausible import LOWEST_SINE, Doubt, Response, doubts, lit, lit_at_night, responses
from solar.frames import FACE_NORMALS, Array
from solar.skies.sky import normal_from_tilt

_BLOCK_S = 60.0
# A cube that is read once a minute, now and then a little early, makes its block of two readings.
_LONGEST_BLOCK_S = 150.0
BLOCKS = 5
"""Minutes whose mean is judged: a passing shadow and the edge of a cloud are no faults."""
BAD_LOOKS = 3
_GOOD_LOOKS = 10
# A face that is found wrong again so soon after it was used again has to agree for twice as long each time.
_RELAPSE_S = 86400.0
_MOST_GOOD_LOOKS = 160
_UPRIGHT = 0.05
_ZENITH = FACES.index("zenith")

_WHY = {
    Doubt.DEAD: "next to nothing while other faces are lit",
    Doubt.DARK: "nothing in daylight",
    Doubt.SAME: "the same as another, two by two",
    Doubt.FROZEN: "the same while the light changes on the others",
    Doubt.OVER: "more than sun and sky can give there",
    Doubt.NIGHT: "light in the night while the others are dark",
    Doubt.ODD: "what the others and the sun's position contradict",
    Doubt.SWAPPED: "each what the other should",
    Doubt.TORN: "what no light explains, and which of them is wrong is not known",
    Doubt.LOOSE: "for a minute now and then what the others do not",
}
_STUCK = "whether the sensor or the channel of {} is stuck"
_CHECK = {
    Doubt.DEAD: "sensor, cable and multiplexer input of {}",
    Doubt.DARK: "the multiplexer's supply and its address lines",
    Doubt.SAME: "whether an address line of the multiplexer is stuck, or its port is dead",
    Doubt.FROZEN: _STUCK,
    Doubt.OVER: "the gain of {}, and whether faces are interchanged",
    Doubt.NIGHT: _STUCK,
    Doubt.ODD: "{} for shade, dirt, reflections, a stuck sensor or a turned mount",
    Doubt.SWAPPED: "whether the cables of {} are swapped",
    Doubt.TORN: "all four, and the clock",
    Doubt.LOOSE: "plug, cable and multiplexer input of {} for a loose contact",
}
# A face that stood still is no better for reading, for a while, what could be true.
_MUST_FOLLOW = (Doubt.FROZEN, Doubt.NIGHT, Doubt.ODD)
_HARD_TO_FORGIVE = (*_MUST_FOLLOW, Doubt.SWAPPED)
# Between its jumps a loose face shows the light, and of four that are torn no one is known to be wrong.
_SHOW_CLOUDS = (Doubt.NONE, Doubt.LOOSE, Doubt.TORN)


def face_normals(cube: CubeSettings, latitude_deg: float) -> Array:
    """Return the unit normals of east, south, west and zenith, shape (4, 3); the south face looks to the equator."""
    named = (90.0, 180.0 if latitude_deg >= 0 else 0.0, 270.0, 180.0)
    faces = [getattr(cube, name) for name in FACES]
    azimuths = [
        azimuth if face.azimuth_deg is None else face.azimuth_deg for face, azimuth in zip(faces, named, strict=True)
    ]
    return normal_from_tilt(np.array([face.tilt_deg for face in faces]), np.array(azimuths), latitude_deg)


class FaceWatch:
    """Judges the faces every minute of daylight, on the mean of the last five.

    A face in doubt three times, one after another, is not believed until it has been lit and without doubts ten times.
    The night, and a clock in doubt, change nothing; a clock that was put right lets all be judged anew.

    Parameters
    ----------
    site, cube
        Where the cube stands and where its faces look.
    clock
        The service's time.
    alarms
        Told which face is not believed, and why.
    clock_watch
        Tells whether the time of day may be used.
    """

    def __init__(
        self,
        site: SiteSettings,
        cube: CubeSettings,
        clock: Clock,
        alarms: Alarms,
        clock_watch: ClockWatch | None = None,
    ) -> None:
        self._sun_direction = SunDirection(site.place())
        self._normals = face_normals(cube, site.latitude_deg)
        self._clock = clock
        self._clock_watch = ClockWatch(clock) if clock_watch is None else clock_watch
        self._sleeps = SleepGauge(clock)
        self._alarms = alarms
        self._since: dict[str, str] = {}
        self._blocks: deque[tuple[Array, Array]] = deque(maxlen=BLOCKS)
        # The light is known from the faces of an upright cube only.
        self._is_upright = bool(np.abs(self._normals - FACE_NORMALS).max() < _UPRIGHT)
        self._minutes: deque[tuple[Array, Array]] = deque(maxlen=MINUTES)
        self._forget()
        self._begin()

    def implausible(self, face: int) -> bool:
        """Tell whether a face, 0 to 3, is not believed."""
        return self._whys[face] is not Doubt.NONE

    def note(self, faces_w_m2: list[float], voltages_mv: list[float]) -> None:
        """Take in one scan, NaN for a face that was not read."""
        for face, (w_m2, mv) in enumerate(zip(faces_w_m2, voltages_mv, strict=True)):
            if not math.isnan(w_m2):
                self._w_m2[face] += w_m2
                self._mv[face] += mv
                self._counts[face] += 1
        elapsed_s = self._clock.monotonic() - self._begun_s
        if elapsed_s < _BLOCK_S:
            return
        if elapsed_s + self._sleeps.take_s() > _LONGEST_BLOCK_S:
            # Nothing was read for a while: a mean over the gap would mix two suns.
            self._blocks.clear()
            self._minutes.clear()
        else:
            self._blocks.append((np.array([self._w_m2, self._mv]), np.array(self._counts)))
        self._begin()
        self._clock_watch.step_s()
        if self._clock_watch.corrections != self._corrections:
            self._forget()
        if not self._clock_watch.trusted:
            self._minutes.clear()
        elif len(self._blocks) == BLOCKS:
            self._judge()

    def _forget(self) -> None:
        """Judge from the beginning: what was found until now was found by a sun that stood elsewhere."""
        self._corrections = self._clock_watch.corrections
        self._bad, self._good = [0] * len(FACES), [0] * len(FACES)
        self._good_needed, self._forgiven_s = [_GOOD_LOOKS] * len(FACES), [-math.inf] * len(FACES)
        self._whys: list[Doubt] = [Doubt.NONE] * len(FACES)
        self._minutes.clear()
        self._contradictions = Contradictions()

    def _begin(self) -> None:
        self._w_m2, self._mv, self._counts = [0.0] * 4, [0.0] * 4, [0] * 4
        self._begun_s = self._clock.monotonic()

    def _judge(self) -> None:
        sun = self._sun_direction(self._clock.utc() - BLOCKS * _BLOCK_S / 2)
        sums, counts = (np.sum(part, axis=0) for part in zip(*self._blocks, strict=True))
        with np.errstate(invalid="ignore"):
            faces, voltages = sums / counts
        if sun[2] < LOWEST_SINE:
            self._judge_night(faces, sun)
        else:
            self._judge_day(faces, voltages, sun)
        self._report()

    def _judge_night(self, faces: Array, sun: Array) -> None:
        self._minutes.clear()
        for face in np.flatnonzero(lit_at_night(faces, sun)).tolist():
            self._count(face, Doubt.NIGHT, sound=False)

    def _judge_day(self, faces: Array, voltages: Array, sun: Array) -> None:
        found = doubts(faces, voltages, sun, self._normals)[0]
        if self.implausible(_ZENITH):
            # What is too much for a vertical face is judged by the zenith face.
            found[:_ZENITH][found[:_ZENITH] == Doubt.OVER] = Doubt.NONE
        light = bool(lit(faces, sun)[0])
        self._add_minute()
        by_minute, suns = (np.array(column) for column in zip(*self._minutes, strict=True))
        jumped = jumps(by_minute)
        # Of jumps close together some are left when they have been settled: who jumps is no witness against others.
        jumping = np.logical_or.reduce(jumped.sure, axis=0)
        followed = self._responses(jumped.settled, suns, jumping)
        against = self._contradicted(jumped.settled, suns)
        if jumping.any():
            against = np.where(jumping, against, Doubt.NONE)
        found[against != Doubt.NONE] = against[against != Doubt.NONE]
        # To stand still is the plainer word for the same face; of two that are swapped one may seem to.
        found[(followed == Response.STAYS) & (found != Doubt.SWAPPED)] = Doubt.FROZEN
        if self._is_upright and len(suns) == MINUTES:
            found[jumped.repeated(suns, [why in _SHOW_CLOUDS for why in self._whys])] = Doubt.LOOSE
        for face, doubt in enumerate(found.tolist()):
            agrees = light and self._agrees(face, followed[face]) and not np.isnan(faces[face])
            self._count(face, Doubt(doubt), sound=agrees)
        self._narrow()
        self._acquit()

    def _agrees(self, face: int, response: int) -> bool:
        """Tell whether a face has done what is asked of it after what was said against it."""
        why = self._whys[face]
        followed = why not in _MUST_FOLLOW or response == Response.FOLLOWS
        return followed and self._contradictions.agrees(face, self._whys)

    def _narrow(self) -> None:
        """Believe the others again once it is known which face they contradicted."""
        if Doubt.TORN in self._whys and any(why not in (Doubt.NONE, Doubt.TORN) for why in self._whys):
            self._whys = [Doubt.NONE if why is Doubt.TORN else why for why in self._whys]

    def _acquit(self) -> None:
        """Believe a frozen face again once it is known that another one has made it look frozen."""
        face = self._contradictions.acquitted
        if face is not None and self._whys[face] is Doubt.FROZEN and Doubt.ODD in self._whys:
            self._whys[face] = Doubt.NONE
            self._bad[face] = 0

    def _add_minute(self) -> None:
        (sums, _), counts = self._blocks[-1]
        with np.errstate(invalid="ignore"):
            self._minutes.append((sums / counts, self._sun_direction(self._clock.utc() - _BLOCK_S / 2)))

    def _contradicted(self, faces: Array, suns: Array) -> NDArray[np.int64]:
        """Tell of each face whether it contradicts the others over the last half hour."""
        if not self._is_upright:
            return np.full(len(FACES), Doubt.NONE, dtype=np.int64)
        against = self._contradictions.look(faces, suns, self._whys)
        still = np.ptp(faces, axis=0) == 0.0
        if len(faces) < MINUTES or not still.any():
            return against
        # What repeats itself to the last digit lies, and beside it sound faces may seem to be swapped.
        return np.where(still, against, Doubt.NONE)

    def _responses(self, faces: Array, suns: Array, jumping: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Tell of each face whether it has followed the light of the last half hour."""
        if not self._is_upright or len(faces) < MINUTES:
            return np.full(len(FACES), Response.UNKNOWN, dtype=np.int64)
        # Among faces that nobody can tell apart, one that stands still tells.
        believed = [why in (Doubt.NONE, Doubt.TORN) and not jumping[face] for face, why in enumerate(self._whys)]
        found = responses(faces, suns, believed)
        stays = np.flatnonzero(found == Response.STAYS)
        fit = misfits(faces, suns) if stays.size else None
        if fit is not None:
            # Where the others contradict each other, what they predict accuses nobody.
            found[[face for face in stays.tolist() if not fit.bears(face)]] = Response.UNKNOWN
        return found

    def _count(self, face: int, doubt: Doubt, *, sound: bool) -> None:
        if doubt is not Doubt.NONE:
            self._bad[face] += 1
            self._good[face] = 0
            # What has to follow the light again, or to stand in order, does so whatever else it reads meanwhile.
            stands = self._whys[face] in _HARD_TO_FORGIVE and doubt not in _HARD_TO_FORGIVE
            if self._bad[face] >= BAD_LOOKS and not stands:
                if self._whys[face] is Doubt.NONE:
                    self._note_relapse(face)
                self._whys[face] = doubt
        elif sound:
            self._bad[face] = 0
            self._good[face] += 1
            if self._good[face] >= self._good_needed[face] and self._whys[face] is not Doubt.NONE:
                self._whys[face] = Doubt.NONE
                self._forgiven_s[face] = self._clock.monotonic()

    def _note_relapse(self, face: int) -> None:
        """Ask more of a face that was used again less than a day ago."""
        soon = self._clock.monotonic() - self._forgiven_s[face] < _RELAPSE_S
        self._good_needed[face] = min(2 * self._good_needed[face], _MOST_GOOD_LOOKS) if soon else _GOOD_LOOKS

    def _report(self) -> None:
        whys = {name: why for name, why in zip(FACES, self._whys, strict=True) if why is not Doubt.NONE}
        if not whys and not self._since:
            # Not 'it is over': what was acknowledged before a restart takes its time to be found again.
            return
        self._since = kept_since(self._since, whys, self._clock)
        self._alarms.set("cube-face", self._told(whys) if whys else None, of=whys)

    def _told(self, whys: Mapping[str, Doubt]) -> str:
        """Say what is wrong with each face before what to do: where a display cuts the text, no face is missing."""
        found: list[str] = []
        checks: list[str] = []
        for doubt in dict.fromkeys(whys.values()):
            names = [name for name, why in whys.items() if why is doubt]
            since = since_each({name: self._since[name] for name in names})
            found.append(f"the {in_a_row(names)} {reads(names)} {_WHY[doubt]}; not used since {since}")
            checks.append(f"check {_CHECK[doubt].format(in_a_row(names))}")
        until = "each agrees" if len(whys) > 1 else "it agrees"
        return f"{'; '.join(found)}, until {until} with the others again: {'; '.join(checks)}"
