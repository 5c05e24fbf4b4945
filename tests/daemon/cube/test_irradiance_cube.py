"""The cube's role on sensors that report irradiances: no multiplexer, no voltmeter, no gains."""

import asyncio
import math
from random import Random

import numpy as np
import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import LoopClock
from daemon.base.records import FACES, Quality
from daemon.base.timeloop import VirtualTimeLoop
from daemon.bridge.senml import encode
from daemon.config.sections import CubeSettings, SiteSettings
from daemon.cube.acquisition import Acquisition
from daemon.cube.face_watch import FaceWatch
from drivers.interfaces import CubeReading, FaceSample

NIGHT = -20.0
NOON_UTC_S = 1665575000.0
OVERFLOW = "the east sensor reports overflow"
SINCE = " (since 2023-11-14 22:13 UTC)"
SILENT = "the zenith sensor does not answer"


class Pyranometers:
    """Four pyranometers; each reports an irradiance [W/m2], or why it does not."""

    def __init__(self, clock):
        self._clock = clock
        self.faces = [300.0, 410.0, 60.0, 470.0]
        self.proven = True
        self.rounded = False
        self.notes = {}

    async def open(self):
        return "four pyranometers"

    async def close(self):
        pass

    async def read(self):
        east, south, west, zenith = map(self._sample, FACES, self.faces)
        return CubeReading(
            east=east,
            south=south,
            west=west,
            zenith=zenith,
            unit="W/m2",
            proven=self.proven,
            rounded=self.rounded,
        )

    def _sample(self, name, face):
        flaw, note = face if isinstance(face, str) else None, self.notes.get(name, "")
        return FaceSample(math.nan if flaw else face, self._clock.utc(), self._clock.monotonic(), flaw, note=note)


@pytest.fixture
def scan_of():
    """Return a function that makes scans with these faces, and returns the last one."""

    def scan(count=1, **changes):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            clock = LoopClock(runner.get_loop().time, 1.7e9)
            cube = Pyranometers(clock)
            vars(cube).update(changes)
            settings = CubeSettings(east={"gain_w_m2_per_mv": 7.0, "offset_mv": 3.0})
            acquisition = Acquisition(
                settings,
                cube,
                clock,
                Random(1),
                lambda _scan: None,
                lambda _event: None,
                lambda _utc_s: NIGHT,
                simulated=True,
            )

            async def scans():
                return [await acquisition.scan() for _ in range(count)][-1]

            return runner.run(scans())

    return scan


def test_irradiances_reported_by_a_cube_are_used_without_gain_and_offset(scan_of):
    scan = scan_of()
    assert [face.irradiance_w_m2 for face in scan.faces] == [300.0, 410.0, 60.0, 470.0]
    assert {face.quality for face in scan.faces} == {Quality.OK}


@pytest.mark.parametrize("kind", [np.float32, np.int16])
def test_numbers_of_numpy_are_sent_as_those_of_python_are(scan_of, kind):
    scans = scan_of(), scan_of(faces=list(map(kind, [300, 410, 60, 470])))
    of_python, of_numpy = (encode(scan).split(b'"n":"session"')[0] for scan in scans)
    assert of_numpy == of_python


def test_no_dark_offset_is_learnt_for_sensors_that_report_irradiances(scan_of):
    scan = scan_of(count=900, faces=[-3.0, -3.0, -3.0, -3.0])
    assert {face.irradiance_w_m2 for face in scan.faces} == {-3.0}


def test_a_flawed_face_does_not_affect_the_other_faces(scan_of):
    scan = scan_of(faces=["late", "missing", "over-range", 470.0])
    assert [face.quality for face in scan.faces] == [Quality.LATE, Quality.MISSING, Quality.OVER_RANGE, Quality.OK]


@pytest.mark.parametrize(
    ("value", "quality"),
    [(math.nan, Quality.MISSING), (math.inf, Quality.IMPLAUSIBLE), (1501.0, Quality.IMPLAUSIBLE)],
)
def test_a_value_that_is_no_irradiance_is_marked_missing_or_implausible(scan_of, value, quality):
    assert scan_of(faces=[300.0, value, 60.0, 470.0]).south.quality is quality


def test_a_failed_self_test_spoils_every_face(scan_of):
    assert {face.quality for face in scan_of(proven=False).faces} == {Quality.SELF_TEST_FAILED}


def test_a_frozen_value_is_stale(scan_of):
    assert {face.quality for face in scan_of(count=7).faces} == {Quality.STALE}


def test_rounded_values_may_repeat_for_a_while_but_become_stale_by_day(scan_of):
    qualities = [{face.quality for face in scan_of(count=count, rounded=True).faces} for count in (7, 361)]
    assert qualities == [{Quality.OK}, {Quality.STALE}]
    assert {face.quality for face in scan_of(count=361, rounded=True, faces=[-1.0] * 4).faces} == {Quality.OK}


@pytest.fixture
def alarmed():
    """Run a scenario with a cube, its alarms, and a function that scans once and returns the active alarms."""

    def run(scenario):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            clock = LoopClock(runner.get_loop().time, 1.7e9)
            cube, events = Pyranometers(clock), []
            alarms = Alarms(clock, events.append)
            acquisition = Acquisition(
                CubeSettings(),
                cube,
                clock,
                Random(1),
                lambda _scan: None,
                events.append,
                lambda _utc_s: NIGHT,
                simulated=True,
                alarms=alarms,
            )

            async def scan(lost="", **notes):
                cube.notes = notes
                cube.faces = ["missing" if name == lost else 400.0 for name in FACES]
                await acquisition.scan()
                return [(alarm.name, alarm.state, alarm.text.replace(SINCE, "")) for alarm in alarms.active]

            runner.run(scenario(scan, alarms))
            return [event.text.partition(":")[0] for event in events]

    return run


def test_a_fault_that_a_sensor_reports_about_itself_is_an_alarm_until_it_is_over(alarmed):
    async def scenario(scan, _alarms):
        assert await scan() == []
        for _ in range(2):
            assert await scan(east=OVERFLOW) == [("cube-sensor", "raised", OVERFLOW)]
        for _ in range(9):
            assert len(await scan()) == 1
        assert await scan() == []

    assert alarmed(scenario) == ["raised cube-sensor", "cleared cube-sensor"]


def test_a_sensor_that_fails_again_and_again_raises_one_alarm_only(alarmed):
    async def scenario(scan, _alarms):
        for number in range(120):
            await scan(**({"zenith": SILENT} if number % 12 < 6 else {}))

    assert alarmed(scenario) == ["raised cube-sensor"]


def test_a_second_sensor_that_fails_after_the_first_was_acknowledged_raises_the_alarm_again(alarmed):
    async def scenario(scan, alarms):
        await scan(east=OVERFLOW)
        alarms.acknowledge("ana")
        assert await scan(east=OVERFLOW) == [("cube-sensor", "acknowledged", OVERFLOW)]
        await asyncio.sleep(60)
        both = f"{OVERFLOW}; {SILENT} (since 2023-11-14 22:14 UTC)"
        assert await scan(east=OVERFLOW, zenith=SILENT) == [("cube-sensor", "raised", both)]

    assert alarmed(scenario) == ["raised cube-sensor", "acknowledged cube-sensor by ana", "raised cube-sensor"]


def test_a_sensor_that_falls_silent_after_its_lesser_fault_was_acknowledged_raises_the_alarm_once(alarmed):
    lesser = "the east sensor (address 1) keeps an error from earlier; its values are used"
    silent = "the east sensor (address 1) does not answer"

    async def scenario(scan, alarms):
        await scan(east=lesser)
        alarms.acknowledge("ana")
        assert await scan(lost="east", east=lesser) == [("cube-sensor", "acknowledged", lesser)], "one late answer"
        assert await scan(lost="east", east=silent) == [("cube-sensor", "raised", silent)]
        alarms.acknowledge("ana")
        for _ in range(5):
            assert await scan(east=lesser) == [("cube-sensor", "acknowledged", lesser)]
            assert await scan(lost="east", east=silent) == [("cube-sensor", "acknowledged", silent)]

    assert alarmed(scenario) == ["raised cube-sensor", "acknowledged cube-sensor by ana"] * 2


def test_an_infinite_irradiance_is_implausible_and_does_not_end_the_acquisition():
    async def scenario():
        clock = LoopClock(asyncio.get_running_loop().time, NOON_UTC_S)
        cube, settings, site = Pyranometers(clock), CubeSettings(), SiteSettings()
        cube.faces[0] = math.inf
        watch = FaceWatch(site, settings, clock, Alarms(clock, lambda _record: None))
        quiet = (lambda _scan: None), (lambda _event: None), (lambda _utc_s: 40.0)
        acquisition = Acquisition(settings, cube, clock, Random(1), *quiet, simulated=True, face_watch=watch)
        for _ in range(480):
            scan = await acquisition.scan()
            await asyncio.sleep(5.0)
        assert scan.east.quality is Quality.IMPLAUSIBLE
        assert b'"n":"east","u"' not in encode(scan)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
