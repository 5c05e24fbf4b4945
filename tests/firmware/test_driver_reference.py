"""The real driver against the maker's firmware: reference runs that end well, and those that do not."""

import asyncio
import os
import signal
import subprocess
import time

import pytest

from drivers.errors import RefusedError
from tests.firmware.live import clear, driver_on, home, move, opened, standstill_after_s, until


async def over(positioner):
    async def ended():
        return not (await positioner.read_telemetry()).homing

    await until(ended)
    return await positioner.read_telemetry()


def freeze_after(act, seconds):
    """Act, and freeze this process for some seconds after that."""
    wake = f"read go; sleep {seconds}; while kill -CONT {os.getpid()}; do sleep 1; done"
    with subprocess.Popen(["/bin/sh", "-c", wake], stdin=subprocess.PIPE) as waker:
        act()
        waker.stdin.close()
        os.kill(os.getpid(), signal.SIGSTOP)
        waker.kill()


def test_both_axes_are_homed_and_no_reference_doubt_remains(start_firmware):
    # A way of some seconds, so that even a busy machine sees more than its end.
    firmware = start_firmware(-47.0, 18.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        for axis, index in (("a", 0), ("b", 1)):
            await home(positioner, axis)
            seen = await over(positioner)
            assert seen.reference_doubt == ""
            assert f"{axis}_low" in seen.details["end_switches"]
            assert firmware.positions_mm()[index] == pytest.approx(-0.37, abs=0.3)
        await positioner.close()

    asyncio.run(scene())


def test_a_reference_run_that_a_supply_dip_breaks_off_leaves_a_doubt_until_a_good_run(start_firmware):
    firmware = start_firmware(-50.0, 90.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        await home(positioner, "a")
        firmware.control("supply 15")
        await asyncio.sleep(0.8)
        firmware.control("supply 24")
        seen = await over(positioner)
        assert "the reference run of A ended at" in seen.reference_doubt
        assert "not on its end switch" in seen.reference_doubt
        # The unit refuses to move for five seconds after its supply is back.
        await asyncio.sleep(5.5)
        await home(positioner, "a")
        assert (await over(positioner)).reference_doubt == ""
        await positioner.close()

    asyncio.run(scene())


def test_a_count_lost_while_telemetry_was_not_read_is_settled_by_one_reference_run(start_firmware):
    firmware = start_firmware(-46.0, 90.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        assert (await positioner.read_telemetry()).reference_doubt == ""
        # After a shorter pause this would be a jump; in 0.8 s an axis might have gone there.
        freeze_after(lambda: firmware.control("count 0 4500"), 0.8)

        async def lost():
            return (await positioner.read_telemetry()).reference_doubt != ""

        await until(lost)
        await home(positioner, "a")
        assert (await over(positioner)).reference_doubt == ""
        await positioner.close()

    asyncio.run(scene())


def test_homing_on_an_end_switch_that_is_stuck_closed_does_not_restore_the_reference(start_firmware):
    firmware = start_firmware(-20.0, 90.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        firmware.control("stucklow 0 1")
        await home(positioner, "a")
        seen = await over(positioner)
        assert "did not move on its reference run" in seen.reference_doubt
        await home(positioner, "a")
        assert "did not move" in (await over(positioner)).reference_doubt, "a second such run proves nothing"
        await clear(positioner)
        assert (await positioner.read_telemetry()).reference_doubt == ""
        await positioner.close()

    asyncio.run(scene())


def test_homing_after_a_contradicted_run_drives_the_axis_off_its_switch_and_settles_the_doubt(start_firmware):
    firmware = start_firmware(-48.0, 90.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        began = firmware.positions_mm()[0]
        await home(positioner, "a")

        async def on_its_way():
            return firmware.positions_mm()[0] < began - 4.0

        await until(on_its_way)
        firmware.control("stucklow 0 1")
        assert "met its end switch where its count was" in (await over(positioner)).reference_doubt
        stood = firmware.positions_mm()[0]
        firmware.control("stucklow 0 0")
        await home(positioner, "a")
        assert firmware.positions_mm()[0] > stood + 10.0, "it was driven off the switch, and is on its way back"
        assert (await over(positioner)).reference_doubt == ""
        assert firmware.positions_mm()[0] == pytest.approx(-0.37, abs=0.3)
        await positioner.close()

    asyncio.run(scene())


def test_an_end_switch_stuck_after_a_restart_is_detected_by_the_position_recalled_from_before(start_firmware):
    firmware = start_firmware(-30.0, 90.0, cleared=False)

    async def scene():
        positioner = driver_on(firmware)
        began = firmware.positions_mm()
        positioner.recall(*began, "")
        await opened(positioner)
        assert (await positioner.read_telemetry()).was_reset
        await clear(positioner, forgive=False)
        await home(positioner, "a")

        async def on_its_way():
            return firmware.positions_mm()[0] < began[0] - 4.0

        await until(on_its_way)
        firmware.control("stucklow 0 1")
        assert "met its end switch where its count was" in (await over(positioner)).reference_doubt
        assert positioner.standing() == pytest.approx(firmware.positions_mm(), abs=1.0)
        await positioner.close()

    asyncio.run(scene())


def test_homing_stops_the_other_axis_first(start_firmware):
    firmware = start_firmware(0.0, 16.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        await move(positioner, -20.0, 16.0)
        await asyncio.sleep(1.5)
        await home(positioner, "b")
        stood_at = firmware.positions_mm()[0]
        await over(positioner)
        assert firmware.positions_mm()[0] == pytest.approx(stood_at, abs=0.05)
        await positioner.close()

    asyncio.run(scene())


def test_dead_hall_sensors_show_as_a_fault_that_refuses_moves_and_can_be_cleared(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        await move(positioner, -20.0, 80.0)
        await asyncio.sleep(1.0)
        firmware.control("freeze 0 1")

        async def told():
            return "a_hall_fault" in (await positioner.read_telemetry()).faults

        await until(told)
        await positioner.halt()
        assert await standstill_after_s(firmware, time.monotonic()) < 0.5
        with pytest.raises(RefusedError, match="it reports a_hall_fault"):
            await positioner.move_to(0.0, 80.0)
        firmware.control("freeze 0 0")
        seen = await clear(positioner)
        assert "a_hall_fault" in seen.faults, "what was cleared is what was seen"
        assert (await positioner.read_telemetry()).faults == ()
        await positioner.close()

    asyncio.run(scene())
