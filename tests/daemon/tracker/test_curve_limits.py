"""When a curve is stopped, left out or judged, exactly at the bounds, with a minimal load."""

import asyncio
import math
from random import Random

import numpy as np
import pytest

from daemon.base.clock import LoopClock
from daemon.base.records import CurveQuality, Event, FaceReading, IvCurve, Quality, Scan
from daemon.base.timeloop import VirtualTimeLoop
from daemon.tracker.curves import IvAcquisition
from drivers.errors import LinkLostError
from drivers.interfaces import SweptCurve
from drivers.settings import LoadSettings


class Load:
    """Gives an open-circuit voltage, and asks whether to stop before its only step."""

    def __init__(self, open_circuit_v=40.0):
        self.open_circuit_v = open_circuit_v
        self.closed = 0
        self.lost = False
        self.between = lambda: None

    async def open(self):
        return "a load"

    async def close(self):
        self.closed += 1

    async def sweep(self, plan, stop_why):
        if self.lost:
            self.lost = False
            raise LinkLostError("load", "it is gone")
        voltages = np.array(plan(self.open_circuit_v))
        self.between()
        # The curve of a module of 9 A, with its knee.
        currents = 9.0 * (1.0 - np.expm1(voltages / 2.0) / math.expm1(self.open_circuit_v / 2.0))
        return SweptCurve(self.open_circuit_v, tuple(voltages), tuple(currents), stop_why() or "")


class Bench:
    def __init__(self, load, sun_deg=30.0, time_known=True, **settings):
        loop = asyncio.get_running_loop()
        self.records, self.load = [], load
        self.acquisition = IvAcquisition(
            LoadSettings(driver="simulated", **settings),
            load,
            LoopClock(loop.time, 1.7e9),
            Random(1),
            self.records.append,
            lambda _utc_s: sun_deg,
            scan_stale_s=15.0,
            time_known=lambda: time_known,
        )

    def zenith(self, w_m2, quality=Quality.OK, age_s=0.0):
        now_s = asyncio.get_running_loop().time() - age_s
        good = FaceReading(100.0, Quality.OK, 0.0, now_s)
        self.acquisition.note(
            Scan("cube", "s", 0, 0.0, now_s, good, good, good, FaceReading(w_m2, quality, 0.0, now_s))
        )

    async def for_s(self, seconds):
        working = asyncio.create_task(self.acquisition.run())
        await asyncio.sleep(seconds)
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)
        return [record for record in self.records if isinstance(record, IvCurve)]


def run(scenario):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scenario())


@pytest.mark.parametrize(("before", "after", "stopped"), [
    (500.0, 549.0, False), (500.0, 551.0, True), (500.0, 451.0, False), (500.0, 449.0, True),
    (20.0, 24.9, False), (20.0, 25.1, True), (math.nan, 500.0, False), (500.0, math.nan, False),
])  # fmt: skip
def test_a_change_of_irradiance_beyond_the_limit_stops_a_curve_and_a_few_watts_at_dusk_do_not(before, after, stopped):
    async def scenario():
        bench = Bench(Load(), abort_change=0.1)
        bench.zenith(before)
        bench.load.between = lambda: bench.zenith(after)
        return (await bench.for_s(1.0))[0]

    curve = run(scenario)
    assert curve.quality is (CurveQuality.STOPPED if stopped else CurveQuality.OK)
    assert curve.zenith_start_w_m2 == pytest.approx(before, nan_ok=True)
    assert curve.zenith_end_w_m2 == pytest.approx(after, nan_ok=True)
    if stopped:
        assert curve.why == f"the zenith irradiance went from {before:.0f} to {after:.0f} W/m2"


@pytest.mark.parametrize(("quality", "age_s", "known"), [
    (Quality.OK, 15.0, True), (Quality.OK, 15.5, False), (Quality.IMPLAUSIBLE, 0.0, False),
])  # fmt: skip
def test_a_curve_gives_the_zenith_irradiance_only_if_the_reading_is_good_and_fresh(quality, age_s, known):
    async def scenario():
        bench = Bench(Load())
        bench.zenith(500.0, quality, age_s)
        return (await bench.for_s(1.0))[0]

    assert run(scenario).zenith_start_w_m2 == pytest.approx(500.0 if known else math.nan, nan_ok=True)


@pytest.mark.parametrize(("sun_deg", "measures"), [(-2.9, True), (-3.1, False)])
def test_no_curve_is_measured_while_the_sun_is_more_than_three_degrees_below_the_horizon(sun_deg, measures):
    async def scenario():
        return await Bench(Load(), sun_deg=sun_deg).for_s(12.0)

    assert len(run(scenario)) == (3 if measures else 0)


def test_while_the_clock_is_in_doubt_curves_are_measured_even_at_seeming_night_and_are_marked():
    async def scenario():
        return await Bench(Load(), sun_deg=-60.0, time_known=False).for_s(12.0)

    assert [curve.quality for curve in run(scenario)] == [CurveQuality.CLOCK] * 3


@pytest.mark.parametrize(("open_circuit_v", "dark"), [(9.9, True), (10.0, False)])
def test_a_curve_is_dark_if_the_open_circuit_voltage_is_below_twice_the_lowest_voltage(open_circuit_v, dark):
    async def scenario():
        return (await Bench(Load(open_circuit_v), minimum_voltage_v=5.0).for_s(1.0))[0]

    curve = run(scenario)
    assert (curve.quality is CurveQuality.DARK) == dark == (curve.points == 0)
    assert not dark or curve.why == "the open-circuit voltage is 9.90 V"


def test_a_curve_with_an_open_circuit_voltage_of_nan_is_not_called_dark():
    async def scenario():
        return (await Bench(Load(math.nan)).for_s(1.0))[0]

    assert run(scenario).quality is CurveQuality.NO_MAXIMUM


def test_the_load_is_closed_when_its_link_is_lost_and_when_the_acquisition_ends():
    async def scenario():
        load = Load()
        load.lost = True
        bench = Bench(load)
        curves = await bench.for_s(60.0)
        told = [event.text for event in bench.records if isinstance(event, Event) and event.subject == "load"]
        return len(curves) > 5, load.closed, told, bench.acquisition.identity

    measured, closed, told, _ = run(scenario)
    assert measured
    assert closed == 2
    assert told == ["the load is down: load: it is gone", "the load is back"]


def test_a_load_driver_that_fails_counts_as_a_lost_load_and_its_traceback_is_logged_once(caplog):
    def fail(*_arguments):
        raise ValueError("no number")

    async def scenario():
        bench = Bench(Load())
        bench.load.sweep, sweep = fail, bench.load.sweep
        working = asyncio.create_task(bench.for_s(120.0))
        await asyncio.sleep(60.0)
        assert bench.acquisition.outage.reason == "load: its driver has failed (ValueError: no number)"
        bench.load.sweep = sweep
        curves = await working
        return curves, [event.text for event in bench.records if isinstance(event, Event)]

    curves, told = run(scenario)
    assert len(curves) > 5
    assert told == ["the load is down: load: its driver has failed (ValueError: no number)", "the load is back"]
    assert len([record for record in caplog.records if record.exc_info]) == 1
