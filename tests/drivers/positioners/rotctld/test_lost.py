"""A rotctld that answers wrongly or not at all is disconnected, and has to be opened again."""

import asyncio

import pytest

from drivers.errors import (
    DeadlineError,
    LinkLostError,
    ProtocolError,
)
from sim_drivers.rotctld.core import RotatorCore
from sim_drivers.transports import InMemoryRotctld
from tests.drivers.positioners.rotctld.told import (
    Told,
    driver_on,
    run,
    told,
)


def test_an_answer_to_another_command_ends_the_connection_to_rotctld():
    async def ask(driver, line):
        line.says["get_pos"] = line.says["stop"]
        with pytest.raises(ProtocolError, match="answers stop to get_pos: is it rotctld"):
            await driver.read_telemetry()
        assert not line.is_open

    told(ask)


def test_a_silent_rotctld_is_a_lost_link_at_the_deadline_and_has_to_be_opened_again():
    async def scenario(now):
        line = InMemoryRotctld(RotatorCore(now(), start=(180.0, 45.0)), now)
        driver = driver_on(line, now, telemetry_stale_s=1.5)
        with pytest.raises(LinkLostError):
            await driver.read_telemetry()
        await driver.open()
        line.frozen, begin_s = True, now()
        with pytest.raises(LinkLostError, match=r"within 1\.5 s: is it rotctld, and does its rotator answer"):
            await driver.read_telemetry()
        assert now() - begin_s == pytest.approx(1.5)
        line.frozen = False
        with pytest.raises(LinkLostError):
            await driver.read_telemetry()
        with pytest.raises(LinkLostError, match="has to be opened first"):
            await driver_on(line, now).move_to(0.0, 45.0)
        await driver.open()
        assert (await driver.read_telemetry()).b_deg == pytest.approx(45.0)

    run(scenario)


@pytest.mark.parametrize("moves", [True, False])
def test_a_rotctld_that_stops_answering_during_a_move_is_sent_a_stop_before_its_line_is_closed(moves):
    class Mute(Told):
        is_mute = False

        async def ask(self, command, within_s):
            reply = await super().ask(command, within_s)
            if self.is_mute:
                await asyncio.sleep(within_s)
                raise DeadlineError("positioner", "did not answer")
            return reply

    async def scene(now):
        line = Mute()
        driver = driver_on(line, now)
        await driver.open()
        await driver.move_to(-10.0, 60.0)
        if not moves:
            await driver.stop()
        line.sent.clear()
        line.is_mute, asked_s = True, now()
        with pytest.raises(LinkLostError, match="did not answer"):
            await driver.read_telemetry()
        assert line.sent == ["get_pos", "stop"][: 1 + moves]
        assert now() - asked_s <= 2.3
        assert not line.is_open

    run(scene)
