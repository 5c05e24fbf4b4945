"""The real driver against the maker's firmware: connection, moves, stops."""

import asyncio
import time
from dataclasses import replace

import pytest

from drivers.errors import LinkLostError, RefusedError
from tests.firmware.live import A, B, clear, driver_on, move, opened, standstill_after_s, taken, until
from tests.firmware.peer import COUNTS_PER_MM

# Braking takes a third of a second; the rest allows for a machine on which emulator and driver have to wait.
STANDS_WITHIN_S = 2.0


def test_the_driver_connects_by_listening_and_finds_that_the_configuration_fits_the_unit(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        identity = await opened(positioner)
        assert (identity.board, identity.setup_conflicts) == ("36A1", ())
        seen = await positioner.read_telemetry()
        assert (seen.supply_v, seen.faults, seen.reference_doubt, seen.own_moves) == (24.0, (), "", ())
        await positioner.close()

    asyncio.run(scene())


# At -50 degrees A is at 9.87 mm: 10 mm would be inside, but an axis runs past its target by up to 0.15 mm.
@pytest.mark.parametrize(("target", "whole_mm"), [((-50.0, 90.0), (11, 282)), ((-48.0, 88.5), (20, 279))])
def test_a_move_ends_at_the_nearest_whole_position_inside_the_limits(start_firmware, target, whole_mm):
    firmware = start_firmware(-47.0, 87.0)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        await move(positioner, *target)

        async def arrived():
            seen = await positioner.read_telemetry()
            return abs(seen.a_deg - target[0]) < 0.5 and abs(seen.b_deg - target[1]) < 0.5

        await until(arrived)
        await standstill_after_s(firmware, time.monotonic())
        await positioner.close()
        # The run-out and a Hall count.
        assert firmware.positions_mm() == pytest.approx(whole_mm, abs=0.15 + 1 / COUNTS_PER_MM)
        a_deg, b_deg = firmware.pose_deg()
        assert a_deg >= -50.0
        assert b_deg <= 90.0

    asyncio.run(scene())


def test_halt_ends_a_move_although_the_first_packet_after_a_usb_enumeration_is_lost(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        for replugged in (False, True):
            await move(positioner, -30.0, 60.0)
            await asyncio.sleep(1.5)
            if replugged:
                firmware.control("replug")
            begin_s = time.monotonic()
            watching = asyncio.create_task(standstill_after_s(firmware, begin_s))
            await positioner.halt()
            # Without the halt the move would have gone on for a minute.
            assert await watching < STANDS_WITHIN_S
        await positioner.close()

    asyncio.run(scene())


def test_a_single_stop_as_the_first_command_of_a_connection_takes_effect(start_firmware):
    firmware = start_firmware()

    async def lost(positioner):
        try:
            await positioner.read_telemetry()
        except LinkLostError:
            return True
        return False

    async def hears(positioner):
        await opened(positioner)
        await move(positioner, -30.0, 60.0)
        await asyncio.sleep(1.0)
        firmware.control("unplug")
        await until(lambda: lost(positioner))
        await positioner.close()
        firmware.control("plug")
        await opened(positioner)
        begin_s = time.monotonic()
        watching = asyncio.create_task(standstill_after_s(firmware, begin_s))
        await positioner.stop()
        stands = await watching < STANDS_WITHIN_S and (await positioner.read_telemetry()).a_deg > -29.0
        await positioner.halt()
        await positioner.close()
        return stands

    async def scene():
        # A busy machine may let the emulator read both packets of a stop at once: as one, the first, they are lost.
        assert await hears(driver_on(firmware)) or await hears(driver_on(firmware))

    asyncio.run(scene())


def test_after_power_up_the_unit_takes_no_target_before_its_status_is_cleared(start_firmware):
    firmware = start_firmware(-20.0, 60.0, cleared=False)

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        assert (await positioner.read_telemetry()).was_reset
        with pytest.raises(RefusedError, match="it has restarted, and may take no target before its status is cleared"):
            await positioner.move_to(0.0, 90.0, first="b")
        await clear(positioner, forgive=False)
        assert "restarted" in (await positioner.read_telemetry()).reference_doubt
        await move(positioner, 0.0, 90.0, first="b")

        async def moves():
            return firmware.pose_deg()[1] > 61.0

        await until(moves)
        await positioner.halt()
        await positioner.close()

    asyncio.run(scene())


def test_the_axis_that_is_named_first_moves_first(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        await move(positioner, -10.0, 80.0, first="b")
        # A is not at zero if an earlier try has reached it.
        a_deg, b_deg = firmware.pose_deg()

        async def moves():
            return firmware.pose_deg()[1] < b_deg - 0.5

        await until(moves)
        assert firmware.pose_deg()[0] == pytest.approx(a_deg, abs=0.1)
        await positioner.halt()
        await positioner.close()

    asyncio.run(scene())


def test_a_move_at_low_motor_supply_is_refused_with_its_cause_and_nothing_moves(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        firmware.control("supply 15")
        before = firmware.positions_mm()

        async def told():
            return (await positioner.read_telemetry()).supply_v < 20.0

        await until(told)
        with pytest.raises(RefusedError, match="its motor supply is 15"):
            await positioner.move_to(-10.0, 80.0)
        firmware.control("supply 24")
        await asyncio.sleep(6.0)
        assert firmware.positions_mm() == pytest.approx(before, abs=0.05)
        await positioner.close()

    asyncio.run(scene())


def test_own_tracking_is_switched_off_and_the_axes_that_it_drove_are_stopped(start_firmware):
    firmware = start_firmware()

    async def scene():
        positioner = driver_on(firmware)
        await opened(positioner)
        firmware.write_parameter(56, "y")

        async def on():
            return (await positioner.read_telemetry()).autonomous

        await until(on)
        await taken(positioner.disable_autonomy)
        assert not (await positioner.read_telemetry()).autonomous
        assert await standstill_after_s(firmware, time.monotonic()) < 0.1
        await positioner.close()

    asyncio.run(scene())


def test_every_setting_of_the_unit_that_contradicts_the_configuration_is_named_with_its_remedy(start_firmware):
    firmware = start_firmware()
    for code, text in ((74, "39.6"), (193, "2.5")):
        firmware.write_parameter(code, text)
        firmware.let_pass(0.1)
    # Writing to the flash puts parameters into force.
    firmware.let_pass(0.5)

    async def scene():
        positioner = driver_on(firmware, b=replace(B, minimum_deg=14.0))
        identity = await opened(positioner)
        holder = "field 74 of the positioner says 39.6, but instruments.positioner.a_axis.holder_mm is 0: set"
        offset = "field 193 of the positioner says 2.5, but instruments.positioner.b_axis.zero_offset is 0: set"
        assert [text.startswith((holder, offset)) for text in identity.setup_conflicts] == [True, True]
        before = firmware.positions_mm()
        with pytest.raises(RefusedError, match="is the geometry that of this unit"):
            await positioner.move_to(-10.0, 80.0)
        assert firmware.positions_mm() == before
        await positioner.close()
        # With the unit's own values in the configuration there is no conflict left.
        a = replace(A, geometry=replace(A.geometry, holder_mm=39.6, low_deg=-51.2))
        positioner = driver_on(firmware, a=replace(a, minimum_deg=-45.0), b=replace(B, zero_offset=2.5))
        identity = await opened(positioner)
        assert identity.setup_conflicts == ()
        await positioner.close()

    asyncio.run(scene())
