"""Services on one broker whose names are similar, or the same by mistake."""

import asyncio

from tests.support.mqtt import SPEED, BrokerRig, run_services, settings_for, until


def rig_of(broker, **mqtt):
    return BrokerRig(asyncio.get_running_loop(), settings_for(broker.port, mqtt=mqtt), SPEED)


def test_services_whose_prefix_and_name_differ_in_a_dash_and_a_slash_are_two_clients(broker, run_scaled):
    async def scenario():
        first, second = rig_of(broker, prefix="lab/roof", name="a"), rig_of(broker, prefix="lab", name="roof-a")
        async with run_services(first, second):
            await until(lambda: first.mqtt.status.connected and second.mqtt.status.connected, "both links")
            await asyncio.sleep(5 * SPEED)
            assert [rig.mqtt.status.connections for rig in (first, second)] == [1, 1]

    run_scaled(scenario)
