"""The metrics: what is among them, and by what name."""

from tests.support.phases import under_way


def test_metrics_are_those_of_prometheus(serve):
    async def scenario(rig, call):
        await under_way(rig)
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

    serve(scenario)
