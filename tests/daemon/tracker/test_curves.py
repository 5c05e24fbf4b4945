import asyncio
import base64
import math

import numpy as np
import pytest

from daemon.api.metrics import Metrics
from daemon.base.records import CurveQuality, Event, IvCurve, Mode, Move
from daemon.service.state import state_json
from solar.pv_module import Q_PEAK_G4_1_305, maximum_power
from tests.daemon.tracker.days import FEWER_SCANS

SIMULATED = {"driver": "simulated"}


def test_every_curve_gives_the_true_maximum_power_and_open_circuit_voltage_of_the_module(run_rig):
    async def scenario(rig):
        errors = []
        await rig.until_mode(Mode.TRACKING, 300)
        while len(errors) < 20:
            seen = len(rig.records_of(IvCurve))
            await rig.until(lambda count=seen: len(rig.records_of(IvCurve)) > count, 10, "the next curve", every_s=0.2)
            truth = rig.source.maximum(rig.source.light(rig.clock.monotonic()))
            last = rig.records_of(Move)[-1:]
            if rig.motion.moving or any(rig.clock.monotonic() - move.time_monotonic_s < 60 for move in last):
                continue
            curve = rig.records_of(IvCurve)[-1]
            assert curve.quality is CurveQuality.OK
            assert curve.voc_v == pytest.approx(float(truth.voc_v), abs=0.05)
            errors.append(curve.pmpp_w / float(truth.pmpp_w) - 1.0)
        assert np.abs(errors).max() < 0.005
        assert abs(np.mean(errors)) < 0.001

    run_rig(scenario, load=SIMULATED)


def test_a_curve_is_measured_every_period_and_the_input_of_the_load_is_off_in_between(run_rig):
    async def scenario(rig):
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 12, 90, "12 curves")
        starts = np.array([curve.time_monotonic_s for curve in rig.records_of(IvCurve)])
        assert np.diff(starts) == pytest.approx(7.0)
        assert not rig.load_core.on
        assert all(curve.points == 20 for curve in rig.records_of(IvCurve))

    run_rig(scenario, load=SIMULATED | {"period_s": 7.0, "points": 20})


def test_a_curve_gives_the_zenith_irradiance_at_its_start_and_end(run_rig):
    async def scenario(rig):
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 5, 60, "5 curves")
        first, last = rig.records_of(IvCurve)[0], rig.records_of(IvCurve)[-1]
        assert math.isnan(first.zenith_start_w_m2)
        ghi = rig.scene.sky_state(rig.clock.utc()).ghi_w_m2
        assert last.zenith_start_w_m2 == pytest.approx(ghi, rel=0.02)
        assert last.zenith_end_w_m2 == pytest.approx(ghi, rel=0.02)

    run_rig(scenario, load=SIMULATED)


def test_a_change_of_light_in_the_middle_of_a_curve_stops_it(run_rig):
    async def scenario(rig):
        # Curves take almost all of the time, so that scans fall into them.
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 5, 60, "5 curves")
        rig.scene.shade(3, 0.5)
        await rig.until(
            lambda: rig.records_of(IvCurve)[-1].quality is CurveQuality.STOPPED, 30, "a curve that was stopped"
        )
        assert "the zenith irradiance went from" in rig.records_of(IvCurve)[-1].why
        await rig.until(lambda: rig.records_of(IvCurve)[-1].quality is CurveQuality.OK, 30, "a whole curve again")

    run_rig(scenario, load=SIMULATED | {"settle_s": 0.13})


def test_the_points_of_a_curve_are_kept_if_keep_curves_is_set(run_rig):
    async def scenario(rig):
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 1, 60, "a curve")
        curve = rig.records_of(IvCurve)[0]
        voltage_v, current_a = np.frombuffer(base64.b64decode(curve.curve), "<f4").reshape(2, -1)
        assert voltage_v.size == curve.points == 30
        assert (np.diff(voltage_v) < 0).all()
        assert (voltage_v * current_a).max() == pytest.approx(curve.pmpp_w, rel=0.01)

    run_rig(scenario, load=SIMULATED | {"keep_curves": True})


def test_an_unplugged_load_is_reported_once_and_tracking_goes_on_undisturbed(run_rig):
    def scenario(unplug):
        async def run(rig):
            await rig.until_mode(Mode.TRACKING, 300)
            if unplug:
                rig.cables.load.link_up = False
            await asyncio.sleep(1200)
            rig.cables.load.link_up = True
            await asyncio.sleep(60)

        return run

    few = SIMULATED | {"period_s": 15.0, "points": 10}
    disturbed, calm = (run_rig(scenario(unplug), load=few, **FEWER_SCANS) for unplug in (True, False))
    texts = [event.text for event in disturbed.records_of(Event) if event.subject == "load"]
    assert len(texts) == 2
    assert texts[0].startswith("the load is down: load:")
    assert texts[1] == "the load is back"
    assert disturbed.records_of(IvCurve)[-1].quality is CurveQuality.OK
    assert len(calm.records_of(IvCurve)) - len(disturbed.records_of(IvCurve)) == pytest.approx(80, abs=3)

    def moves(rig):
        return np.array([(move.time_utc_s, move.target_a_deg, move.target_b_deg) for move in rig.records_of(Move)])

    # Whether a mean includes a scan at its edge depends on a nanosecond.
    assert moves(disturbed) == pytest.approx(moves(calm), abs=0.02)
    assert len(moves(calm)) > 3
    # By now the service has ended.
    assert not disturbed.load_core.on
    assert not calm.load_core.on


def test_a_load_that_fails_in_the_middle_of_a_curve_has_its_input_off(run_rig):
    async def scenario(rig):
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 2, 60, "two curves")
        await rig.until(lambda: rig.load_core.on, 10, "a curve", every_s=0.001)
        rig.load_core.drop_next()
        await rig.until(lambda: rig.tracker.curves.outage.is_down, 30, "the outage")
        assert not rig.load_core.on
        await rig.until(lambda: not rig.tracker.curves.outage.is_down, 30, "its end")

    run_rig(scenario, load=SIMULATED)


def test_a_service_that_ends_in_the_middle_of_a_curve_leaves_the_input_of_the_load_off(run_rig):
    async def scenario(rig):
        await rig.until(lambda: rig.load_core.on, 60, "a curve")

    assert not run_rig(scenario, load=SIMULATED).load_core.on


def test_a_curve_that_is_stopped_by_a_tripped_protection_of_the_load_names_the_protection(run_rig):
    async def scenario(rig):
        await rig.until(lambda: rig.load_core.on, 60, "a curve")
        rig.load_core.trip("over-temperature")
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 1, 60, "the curve")
        assert rig.records_of(IvCurve)[-1].quality is CurveQuality.STOPPED
        assert rig.records_of(IvCurve)[-1].why == "protection tripped: over-temperature"
        await rig.until(lambda: rig.records_of(IvCurve)[-1].quality is CurveQuality.OK, 60, "the next curve")

    run_rig(scenario, load=SIMULATED)


def test_no_curve_is_measured_at_night_before_the_sun_is_three_degrees_below_the_horizon(run_rig):
    async def scenario(rig):
        await asyncio.sleep(600)
        assert rig.records_of(IvCurve) == []
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 1, 7200, "the first curve", every_s=1.0)
        assert rig.service.sun_elevation_deg(rig.clock.utc()) == pytest.approx(-3.0, abs=0.2)

    run_rig(scenario, start="2022-10-12T05:20", rest_look_s=5.0, load=SIMULATED)


def test_the_curve_of_a_module_without_light_is_marked_dark_and_gives_no_power(run_rig):
    async def scenario(rig):
        rig.weather.dni = rig.weather.dhi = 0.0
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 1, 60, "a curve")
        curve = rig.records_of(IvCurve)[0]
        assert curve.quality is CurveQuality.DARK
        assert math.isnan(curve.pmpp_w)
        assert rig.load_core.sweeps == 0

    run_rig(scenario, load=SIMULATED)


def test_without_a_load_there_are_no_curves(run_rig):
    async def scenario(rig):
        await asyncio.sleep(60)
        assert rig.tracker.curves is None
        assert rig.records_of(IvCurve) == []

    run_rig(scenario)


def test_the_simulated_module_is_brighter_and_warmer_when_it_faces_the_sun_than_when_it_is_flat(run_rig):
    async def scenario(rig):
        flat = rig.source.light(rig.clock.monotonic())
        await rig.until_mode(Mode.TRACKING, 300)
        await asyncio.sleep(600)
        facing = rig.source.light(rig.clock.monotonic())
        assert facing.irradiance_w_m2 > 1.2 * flat.irradiance_w_m2
        assert facing.cell_c > flat.cell_c
        assert rig.records_of(IvCurve)[-1].pmpp_w == pytest.approx(
            float(maximum_power(Q_PEAK_G4_1_305, *facing).pmpp_w), rel=0.005
        )

    run_rig(scenario, load=SIMULATED | {"period_s": 60.0})


def test_the_load_and_its_last_curve_are_shown_in_the_state_and_the_metrics(run_rig):
    async def scenario(rig):
        assert "heliocube_module_power_watts" not in Metrics(rig.take_snapshot(), {}).text().decode()
        await rig.until(lambda: len(rig.records_of(IvCurve)) >= 1, 60, "a curve")
        assert 'heliocube_load_up{tracker="tracker"} 1.0' in Metrics(rig.take_snapshot(), {}).text().decode()
        power_w = rig.records_of(IvCurve)[-1].pmpp_w
        assert (
            f'heliocube_module_power_watts{{tracker="tracker"}} {power_w}'
            in Metrics(rig.take_snapshot(), {}).text().decode()
        )
        seen = state_json(rig.take_snapshot())["load"]
        assert seen["connected"]
        assert seen["curve"]["pmpp_w"] == power_w
        assert seen["curve"]["curve"] == ""
        rig.cables.load.link_up = False
        await rig.until(lambda: rig.tracker.curves.outage.is_down, 30, "the outage")
        assert "unplugged" in state_json(rig.take_snapshot())["load"]["down_why"]
        assert 'heliocube_load_up{tracker="tracker"} 0.0' in Metrics(rig.take_snapshot(), {}).text().decode()

    run_rig(scenario, load=SIMULATED)
