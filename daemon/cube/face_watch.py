"""Finding faces that cannot be true, without a self-test: each is compared with the others, the sun, a clear sky."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch
from daemon.base.records import FACES
from daemon.base.sleeps import SleepGauge
from daemon.config.sections import CubeSettings, SiteSettings
from daemon.cube.contradictions import MINUTES, Contradictions
from daemon.cube.face_alarms import face_reads_text, join_names, since_text, update_since
from solar.ephemeris import SunDirection
from solar.faces.contradiction import misfits
from solar.faces.jumps import find_jumps
from solar.faces.plausible import LOWEST_SUN_SINE, Doubt, Response, doubts, is_lit, lit_at_night, responses
from solar.frames import FACE_NORMALS, Array
from solar.skies.sky import normal_from_tilt

_BLOCK_S = 60.0
# A cube that is read once a minute, and now and then a little early, fills a block with two readings.
_LONGEST_BLOCK_S = 150.0
BLOCKS = 5
"""The faces are judged by their means over so many minutes: a passing shadow or the edge of a cloud is no fault."""
_NO_BLOCKS = np.empty((0, 3, len(FACES)))
BAD_LOOKS = 3
_GOOD_LOOKS = 10
# A face that is found wrong again within this time after it was used again has to agree for twice as long each time.
_RELAPSE_S = 86400.0
_MOST_GOOD_LOOKS = 160
_UPRIGHT = 0.05
_ZENITH = FACES.index("zenith")

_WHY = {
    Doubt.DEAD: "next to nothing while other faces are lit",
    Doubt.DARK: "nothing in daylight",
    Doubt.SAME: "the same as another face, in pairs",
    Doubt.FROZEN: "the same while the light changes on the others",
    Doubt.TOO_BRIGHT: "more than sun and sky can give there",
    Doubt.NIGHT: "light in the night while the others are dark",
    Doubt.CONTRADICTED: "what the others and the sun's position contradict",
    Doubt.SWAPPED: "each other's light",
    Doubt.INCONSISTENT: "what no light explains, and it is not known which of them is wrong",
    Doubt.LOOSE_CONTACT: "for a minute now and then what the others do not",
}
_STUCK_CHECK = "whether the sensor or the channel of {} is stuck"
_WHAT_TO_CHECK = {
    Doubt.DEAD: "sensor, cable and multiplexer input of {}",
    Doubt.DARK: "the multiplexer's supply and its address lines",
    Doubt.SAME: "whether an address line of the multiplexer is stuck, or its port is dead",
    Doubt.FROZEN: _STUCK_CHECK,
    Doubt.TOO_BRIGHT: "the gain of {}, and whether faces are interchanged",
    Doubt.NIGHT: _STUCK_CHECK,
    Doubt.CONTRADICTED: "{} for shade, dirt, reflections, a stuck sensor or a turned mount",
    Doubt.SWAPPED: "whether the cables of {} are swapped",
    Doubt.INCONSISTENT: "all four, and the clock",
    Doubt.LOOSE_CONTACT: "plug, cable and multiplexer input of {} for a loose contact",
}
# A face under one of these doubts is not cleared by plausible readings alone: these may come by chance for a while.
_MUST_FOLLOW = (Doubt.FROZEN, Doubt.NIGHT, Doubt.CONTRADICTED)
_HARD_TO_FORGIVE = (*_MUST_FOLLOW, Doubt.SWAPPED)
# Between its jumps a loose face shows the light, and of four torn faces none is known to be wrong.
_SHOW_CLOUDS = (Doubt.NONE, Doubt.LOOSE_CONTACT, Doubt.INCONSISTENT)


def face_normals(cube: CubeSettings, latitude_deg: float) -> Array:
    """Return the unit normals of east, south, west and zenith, shape (4, 3); the south face looks to the equator."""
    named = (90.0, 180.0 if latitude_deg >= 0 else 0.0, 270.0, 180.0)
    faces = [getattr(cube, name) for name in FACES]
    azimuths = [
        azimuth if face.azimuth_deg is None else face.azimuth_deg for face, azimuth in zip(faces, named, strict=True)
    ]
    return normal_from_tilt(np.array([face.tilt_deg for face in faces]), np.array(azimuths), latitude_deg)


def _means(sums: Array) -> Array:
    """Return means, shape (2, 4), from the sums and their counts, shape (3, 4); NaN where nothing was counted."""
    with np.errstate(invalid="ignore"):
        means: Array = sums[:2] / sums[2]
    return means


def _append_row(kept: Array, newest: Array, most: int) -> Array:
    """Return the kept rows with the newest one behind them: of all, the last `most`."""
    return np.concatenate([kept[1 - most :], newest[None]])


class FaceWatch:
    """Judges the faces every minute of daylight, on the mean of the last five.

    A face in doubt three times, one after another, is not believed until it has been lit and without doubts ten times.
    At night only light on one face alone counts. A clock in doubt changes nothing; after a clock was put right, all
    faces are judged anew.

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
        # For each block its sums [W/m2] and [mV] and their counts, shape (n, 3, 4).
        self._blocks = _NO_BLOCKS
        # The light is known from the faces of an upright cube only.
        self._is_upright = bool(np.abs(self._normals - FACE_NORMALS).max() < _UPRIGHT)
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
            self._blocks = _NO_BLOCKS
            self._forget_minutes()
        else:
            self._blocks = _append_row(self._blocks, np.array([self._w_m2, self._mv, self._counts]), BLOCKS)
        self._begin()
        self._clock_watch.step_s()
        if self._clock_watch.corrections != self._corrections:
            self._forget()
        if not self._clock_watch.trusted:
            self._forget_minutes()
        elif len(self._blocks) == BLOCKS:
            self._judge()

    def _forget(self) -> None:
        """Judge from the beginning: the findings until now assumed a sun that stood elsewhere."""
        self._corrections = self._clock_watch.corrections
        self._bad_looks, self._good_looks = [0] * len(FACES), [0] * len(FACES)
        self._good_needed, self._forgiven_s = [_GOOD_LOOKS] * len(FACES), [-math.inf] * len(FACES)
        self._whys: list[Doubt] = [Doubt.NONE] * len(FACES)
        self._forget_minutes()
        self._contradictions = Contradictions()

    def _forget_minutes(self) -> None:
        """Begin the half hour anew: what the faces read in each of its minutes, and where the sun stood."""
        self._faces, self._suns = np.empty((0, len(FACES))), np.empty((0, 3))

    def _begin(self) -> None:
        self._w_m2, self._mv, self._counts = [0.0] * 4, [0.0] * 4, [0] * 4
        self._begun_s = self._clock.monotonic()

    def _judge(self) -> None:
        sun = self._sun_direction(self._clock.utc() - BLOCKS * _BLOCK_S / 2)
        faces, voltages = _means(self._blocks.sum(axis=0)).tolist()
        if sun[2] < LOWEST_SUN_SINE:
            self._judge_night(faces, sun)
        else:
            self._judge_day(faces, voltages, sun)
        self._report()

    def _judge_night(self, faces: Sequence[float], sun: Array) -> None:
        self._forget_minutes()
        for face in np.flatnonzero(lit_at_night(faces, sun)).tolist():
            self._count(face, Doubt.NIGHT, sound=False)

    def _judge_day(self, faces: Sequence[float], voltages: Sequence[float], sun: Array) -> None:
        found = doubts(faces, voltages, sun, self._normals)
        if self.implausible(_ZENITH):
            # What is too much for a vertical face is judged by the zenith face, which is not believed now.
            found[:_ZENITH] = [Doubt.NONE if doubt is Doubt.TOO_BRIGHT else doubt for doubt in found[:_ZENITH]]
        light = is_lit(faces, sun)
        self._add_minute()
        jumped = find_jumps(self._faces)
        # `without_jumps` leaves some jumps that were close together: so a face that jumps is no witness against others.
        jumping = np.logical_or.reduce(jumped.sure, axis=0).tolist()
        followed = self._responses(jumped.without_jumps, jumping)
        against = self._contradiction_doubts(jumped.without_jumps, jumping)
        loose = [False] * len(FACES)
        if self._is_upright and len(self._suns) == MINUTES and any(jumping):
            loose = jumped.repeated(self._suns, [why in _SHOW_CLOUDS for why in self._whys]).tolist()
        for face, (seen, contradicts) in enumerate(zip(found, against, strict=True)):
            doubt = seen if contradicts is Doubt.NONE else contradicts
            # Frozen is the plainer name for the same fault; but of two swapped faces, one may only seem frozen.
            if followed[face] is Response.STAYS and doubt is not Doubt.SWAPPED:
                doubt = Doubt.FROZEN
            if loose[face]:
                doubt = Doubt.LOOSE_CONTACT
            known = light and not math.isnan(faces[face])
            sound = known and doubt is Doubt.NONE and self._agrees(face, followed[face])
            self._count(face, doubt, sound=sound)
        self._clear_torn_faces()
        self._acquit()

    def _agrees(self, face: int, response: Response) -> bool:
        """Tell whether a face has done what the doubt that it is under demands before it is believed again."""
        why = self._whys[face]
        followed = why not in _MUST_FOLLOW or response is Response.FOLLOWS
        return followed and self._contradictions.agrees(face, self._whys)

    def _clear_torn_faces(self) -> None:
        """Believe the others again once it is known which face they contradicted."""
        if Doubt.INCONSISTENT in self._whys and any(why not in (Doubt.NONE, Doubt.INCONSISTENT) for why in self._whys):
            self._whys = [Doubt.NONE if why is Doubt.INCONSISTENT else why for why in self._whys]

    def _acquit(self) -> None:
        """Believe a frozen face again once it is known that another one has made it look frozen."""
        face = self._contradictions.wrongly_frozen_face
        if face is not None and self._whys[face] is Doubt.FROZEN and Doubt.CONTRADICTED in self._whys:
            self._whys[face] = Doubt.NONE
            self._bad_looks[face] = 0

    def _add_minute(self) -> None:
        sun = self._sun_direction(self._clock.utc() - _BLOCK_S / 2)
        self._faces = _append_row(self._faces, _means(self._blocks[-1])[0], MINUTES)
        self._suns = _append_row(self._suns, sun, MINUTES)

    def _contradiction_doubts(self, faces: Array, jumping: Sequence[bool]) -> list[Doubt]:
        """Tell of each face whether it contradicts the others over the last half hour."""
        if not self._is_upright:
            return [Doubt.NONE] * len(FACES)
        against = self._contradictions.find_doubts(faces, self._suns, self._whys)
        if not any(against):
            return against
        accused = jumping if any(jumping) else [True] * len(FACES)
        still = (np.ptp(faces, axis=0) == 0.0).tolist()
        if len(faces) == MINUTES and any(still):
            # A face that repeats itself to the last digit is wrong, and beside it sound faces may seem to be swapped.
            accused = [one and other for one, other in zip(accused, still, strict=True)]
        return [doubt if is_one else Doubt.NONE for doubt, is_one in zip(against, accused, strict=True)]

    def _responses(self, faces: Array, jumping: Sequence[bool]) -> list[Response]:
        """Tell of each face whether it has followed the light of the last half hour."""
        if not self._is_upright or len(faces) < MINUTES:
            return [Response.UNKNOWN] * len(FACES)
        # Torn faces are included: if one of them stands still, that tells which one is wrong.
        believed = [
            why in (Doubt.NONE, Doubt.INCONSISTENT) and not jumping[face] for face, why in enumerate(self._whys)
        ]
        found = responses(faces, self._suns, believed)
        if Response.STAYS in found:
            face, fit = found.index(Response.STAYS), misfits(faces, self._suns)
            if fit is not None and not fit.others_agree_without(face):
                # If the others contradict each other, their prediction accuses nobody.
                found[face] = Response.UNKNOWN
        return found

    def _count(self, face: int, doubt: Doubt, *, sound: bool) -> None:
        if doubt is not Doubt.NONE:
            self._bad_looks[face] += 1
            self._good_looks[face] = 0
            # A face that must follow the light or be in order again has to do so whatever else is found meanwhile.
            stands = self._whys[face] in _HARD_TO_FORGIVE and doubt not in _HARD_TO_FORGIVE
            if self._bad_looks[face] >= BAD_LOOKS and not stands:
                if self._whys[face] is Doubt.NONE:
                    self._note_relapse(face)
                self._whys[face] = doubt
        elif sound:
            self._bad_looks[face] = 0
            self._good_looks[face] += 1
            if self._good_looks[face] >= self._good_needed[face] and self._whys[face] is not Doubt.NONE:
                self._whys[face] = Doubt.NONE
                self._forgiven_s[face] = self._clock.monotonic()

    def _note_relapse(self, face: int) -> None:
        """Ask more of a face that was used again less than a day ago."""
        soon = self._clock.monotonic() - self._forgiven_s[face] < _RELAPSE_S
        self._good_needed[face] = min(2 * self._good_needed[face], _MOST_GOOD_LOOKS) if soon else _GOOD_LOOKS

    def _report(self) -> None:
        whys = {name: why for name, why in zip(FACES, self._whys, strict=True) if why is not Doubt.NONE}
        if not whys and not self._since:
            # Do not end the alarm: a fault that was acknowledged before a restart takes its time to be found again.
            return
        self._since = update_since(self._since, whys, self._clock)
        self._alarms.set("cube-face", self._alarm_text(whys) if whys else None, of=whys)

    def _alarm_text(self, whys: Mapping[str, Doubt]) -> str:
        """Say what is wrong with each face before what to do: where a display cuts the text, no face is missing."""
        found: list[str] = []
        checks: list[str] = []
        for doubt in dict.fromkeys(whys.values()):
            names = [name for name, why in whys.items() if why is doubt]
            since = since_text({name: self._since[name] for name in names})
            found.append(f"the {join_names(names)} {face_reads_text(names)} {_WHY[doubt]}; not used since {since}")
            checks.append(f"check {_WHAT_TO_CHECK[doubt].format(join_names(names))}")
        until = "each agrees" if len(whys) > 1 else "it agrees"
        return f"{'; '.join(found)}, until {until} with the others again: {'; '.join(checks)}"
