"""The metrics: which there are, and their names."""

from dataclasses import replace

from daemon.api.metrics import Metrics
from solar.frames import Angles
from tests.daemon.bridge.desk import Desk, scan
from tests.support.phases import wait_for_move


def test_metrics_page_has_prometheus_format_and_only_heliocube_names(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        reply = await call.get("/metrics")
        lines = reply.body.decode().splitlines()
        assert "text/plain" in reply.head
        assert 'heliocube_info{role="both",simulated="true",version="0.1.0"} 1.0' in lines
        assert 'heliocube_mode{mode="tracking",tracker="tracker"} 1.0' in lines
        assert 'heliocube_moving{tracker="tracker"} 1.0' in lines
        assert f'heliocube_angle_degrees{{axis="a",tracker="tracker"}} {rig.motion.pose.a_deg}' in lines
        names = [line.split("{")[0].split()[0] for line in lines if not line.startswith("#")]
        assert all(name.startswith("heliocube_") for name in names)
        assert "python_info" not in names
        (about,) = (line for line in lines if line.startswith("# HELP heliocube_loop_late_worst_seconds "))
        assert about.endswith(" in the last minute or two.")

    serve(scenario)


def test_an_angle_of_minus_zero_appears_in_the_metrics_without_a_sign(run_rig):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.pose is not None, 60, "a pose")
        seen = rig.take_snapshot()
        (tracker,) = seen.trackers
        level = replace(tracker.positioner, pose=Angles(-0.0, 90.0))
        text = Metrics(replace(seen, trackers=(replace(tracker, positioner=level),)), {}).text().decode()
        assert 'heliocube_angle_degrees{axis="a",tracker="tracker"} 0.0' in text.splitlines()

    run_rig(scenario)


def test_the_fault_metric_is_absent_rather_than_zero_while_the_positioner_does_not_answer(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        assert b'heliocube_faults{tracker="tracker"} 0.0' in (await call.get("/metrics")).body
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 60, "the loss of the link")
        assert b"heliocube_faults" not in (await call.get("/metrics")).body

    serve(scenario)


def test_the_count_of_lost_scans_never_falls_since_prometheus_takes_a_fall_for_a_restart(run_rig):
    async def scenario(rig):
        desk, lost = Desk(), []
        for number in (3, 40, 41, 20, 21, 43, 2, 1):
            desk.follow(scan(number))
            text = Metrics(replace(rig.take_snapshot(), bridge=desk.receiver.statistics), {}).text().decode()
            (line,) = [line for line in text.splitlines() if line.startswith("heliocube_bridge_lost_total ")]
            lost.append(float(line.split()[1]))
        assert lost == [0.0, 36.0, 36.0, 36.0, 36.0, 37.0, 38.0, 39.0]

    run_rig(scenario)
