"""The registers on the rig under virtual time: what they say about it, and what a write does and may not do."""

import asyncio

import pytest

from daemon.base.records import Event, Mode
from daemon.service.operator import Operator
from daemon.sunspec.models import BASE, SunSpecMap
from daemon.sunspec.table import SunSpecTable
from drivers.modbus.pdu import ModbusRequest, decode_number, read_registers, registers_of, write_register
from tests.daemon.sunspec.desk import UNIT, Control, int32, on_rig
from tests.support.phases import wait_for_rest
from tests.support.rig import ServiceRig


def test_the_models_show_the_irradiances_the_site_and_the_pose_of_the_rig(run_rig):
    async def scenario(rig, control):
        await asyncio.sleep(11)
        models = await control.models()
        assert list(models) == [1, 302, 305, 307, 601]
        scan = control.take_snapshot().scan
        points = models[302][1]
        assert (points[0], points[9], points[14], points[19]) == tuple(
            round(face.irradiance_w_m2) for face in (scan.zenith, scan.east, scan.south, scan.west)
        )
        place = models[305][1]
        assert decode_number(place[30:32], "int32") / 1e7 == pytest.approx(48.717607, abs=1e-6)
        assert models[307][1][3] == 3
        tracker = models[601][1]
        assert (len(tracker), tracker[8], tracker[24], tracker[25]) == (48, 5, 0xFFFE, 1)
        block = tracker[26:]
        elevation, azimuth = (decode_number(block[at : at + 2], "int32") / 100 for at in (12, 14))
        direction = SunSpecMap("x", 1, {})._angles("x", *rig.truth(), 48.7)
        assert (elevation, azimuth) == pytest.approx(
            (decode_number(direction[:2], "int32") / 100, decode_number(direction[2:], "int32") / 100), abs=0.3
        )
        assert block[20:] == (0, 0)

    on_rig(run_rig, scenario)


def test_stale_irradiances_and_a_stale_pose_are_read_as_not_implemented_and_not_as_numbers(run_rig):
    async def scenario(rig, control):
        rig.cables.voltmeter.link_up = rig.cables.positioner.link_up = False
        await asyncio.sleep(60)
        models = await control.models()
        assert set(models[302][1]) == {0xFFFF}
        assert models[601][1][26 + 12 : 26 + 16] == (0x8000, 0, 0x8000, 0)

    on_rig(run_rig, scenario)


def test_a_read_beyond_the_registers_another_unit_and_an_unknown_function_get_modbus_exceptions(run_rig):
    async def scenario(rig, control):
        assert (await control.ask(read_registers(UNIT, 3, BASE - 1, 2)))[1] == 2
        assert (await control.ask(read_registers(UNIT, 3, BASE + 400, 2)))[1] == 2
        assert (await control.ask(read_registers(9, 3, BASE, 2)))[1] == 11
        assert (await control.ask(ModbusRequest(UNIT, b"\x08\x00\x00\x00\x00")))[1] == 1

    on_rig(run_rig, scenario)


@pytest.mark.parametrize("unit", [0, 255])
def test_requests_to_units_0_and_255_which_mean_the_device_itself_on_tcp_are_answered(run_rig, unit):
    async def scenario(rig, control):
        assert registers_of(await control.ask(read_registers(unit, 3, BASE, 2))) == (0x5375, 0x6E53)

    on_rig(run_rig, scenario)


def test_mode_manual_with_angles_is_a_goto_and_mode_automatic_returns_the_tracker_to_tracking(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        # Azimuth 217.01, elevation 33.83 is A 30, B 40.
        assert await control.write(at, [*int32(3383), *int32(21701), 1]) == 0
        await rig.until(lambda: rig.truth() == pytest.approx((30.0, 40.0), abs=0.8), 120, "the manual target")
        assert rig.mode is Mode.HOLD
        await wait_for_rest(rig)
        await asyncio.sleep(15)
        points = (await control.models())[601][1]
        assert (decode_number(points[18:20], "int32"), points[22], points[26 + 20]) == (3383.0, 1, 1)
        assert points[26 + 21] == 0
        assert decode_number(points[26 + 8 : 26 + 10], "int32") == pytest.approx(3383, abs=1)
        assert await control.write(at + 4, [0]) == 0
        await rig.until_mode(Mode.TRACKING, 60)
        assert (await control.models())[601][1][18:23] == (0x8000, 0, 0x8000, 0, 0)

    on_rig(run_rig, scenario)


def test_written_angles_take_effect_only_with_the_mode_and_manual_without_angles_is_a_hold(run_rig):
    async def scenario(rig, control):
        first = (await control.models())[601][0]
        tracker = first + 28 + 16
        assert await control.write(tracker + 4, [1]) == 0
        assert rig.mode is Mode.HOLD
        assert await control.write(tracker, int32(9000)) == 0
        assert await control.write(tracker + 2, int32(18000)) == 0
        await asyncio.sleep(20)
        assert rig.truth()[1] != pytest.approx(90.0, abs=1.0)
        reply = await control.ask(write_register(UNIT, tracker + 4, 1))
        assert not reply[0] & 0x80
        await rig.until(lambda: rig.truth()[1] == pytest.approx(90.0, abs=0.8), 120, "flat")

    on_rig(run_rig, scenario)


@pytest.mark.parametrize("ended_by", ["auto", "stop", "goto"])
def test_manual_without_angles_holds_the_tracker_in_place_after_a_person_ended_the_last_override(run_rig, ended_by):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        assert await control.write(at, [*int32(3383), *int32(21701), 1]) == 0
        await rig.until(lambda: rig.truth() == pytest.approx((30.0, 40.0), abs=0.8), 120, "the manual target")
        assert await control.write(at + 4, [1]) == 0
        assert (await control.read(at, 5))[:4] == (*int32(3383), *int32(21701))
        if ended_by == "goto":
            rig.control.goto(20.0, 60.0, "to be seen", "ana")
        if ended_by == "stop":
            await rig.control.stop("a hand in the gear", "ana")
        rig.control.auto()
        await asyncio.sleep(60)
        await wait_for_rest(rig)
        before = rig.truth()
        assert await control.write(at + 4, [1]) == 0
        assert await control.read(at, 5) == (0x8000, 0, 0x8000, 0, 1)
        await asyncio.sleep(60)
        assert rig.truth() == pytest.approx(before, abs=0.5)

    on_rig(run_rig, scenario)


def test_angles_written_without_a_mode_are_forgotten_after_five_minutes(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        assert await control.write(at, [*int32(3383), *int32(21701)]) == 0
        await asyncio.sleep(290)
        assert (await control.read(at, 4)) == (*int32(3383), *int32(21701))
        await asyncio.sleep(20)
        assert (await control.read(at, 4)) == (0x8000, 0, 0x8000, 0)

    on_rig(run_rig, scenario)


def test_a_block_that_is_written_back_as_it_was_read_sets_no_angle(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        block = list(await control.read(at, 5))
        assert block == [0x8000, 0, 0x8000, 0, 0]
        assert await control.write(at, [*block[:4], 1]) == 0
        assert rig.mode is Mode.HOLD
        assert await control.write(at, [*int32(3383), *int32(21701)]) == 0
        assert await control.write(at, block) == 0
        assert await control.read(at, 4) == (0x8000, 0, 0x8000, 0)
        assert rig.mode is not Mode.HOLD
        assert await control.write(at, [*int32(3383), 0x8000, 0, 1]) == 3

    on_rig(run_rig, scenario)


def test_manual_with_one_angle_and_not_the_other_is_refused(run_rig, caplog):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        assert await control.write(at, int32(9000)) == 0
        assert await control.write(at + 4, [1]) == 3
        why = f"127.0.0.1, register {at + 4}: does not take the value or the count (exception 3)"
        assert caplog.messages[-1] == f"a write over SunSpec is refused: {why}"
        assert rig.mode is Mode.TRACKING

    on_rig(run_rig, scenario)


WRONG = {
    "half an angle": (0, [1]),
    "the other half": (1, [1]),
    "an angle and a half": (0, [0, 3000, 0]),
    "calibrate": (4, [2]),
    "beyond the horizon": (0, [*int32(-100), *int32(18000)]),
    "out of reach, north": (0, [*int32(3000), *int32(9000), 1]),
    "out of reach, too flat to the west": (0, [*int32(7000), *int32(30000), 1]),
}


def test_writes_of_impossible_values_or_to_other_registers_are_refused_and_move_nothing(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        before = rig.truth()
        codes = {name: await control.write(at + offset, values) for name, (offset, values) in WRONG.items()}
        assert codes == dict.fromkeys(WRONG, 3)
        assert await control.write(at + 5, [1]) == 2
        assert await control.write(BASE + 4, [1]) == 2
        await asyncio.sleep(10)
        assert rig.truth() == pytest.approx(before, abs=0.1)
        assert rig.mode is Mode.TRACKING

    on_rig(run_rig, scenario)


def test_a_write_is_refused_while_sunspec_manual_is_false(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        assert await control.write(at, [*int32(9000), *int32(18000), 1]) == 1
        assert rig.mode is Mode.TRACKING

    on_rig(run_rig, scenario, manual=False)


def test_a_persons_stop_is_not_ended_from_the_control_room(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        await rig.control.stop("somebody is at the axes", "ana")
        assert await control.write(at + 4, [0]) == 4
        assert await control.write(at, [*int32(3383), *int32(21701)]) == 0
        assert await control.write(at, [*int32(9000), *int32(18000), 1]) == 4
        # Otherwise a mode that is written alone later would move the tracker to the target that was refused.
        assert await control.read(at, 4) == (*int32(3383), *int32(21701))
        assert rig.control.wishes.stop is not None
        assert (await control.models())[601][1][22] == 1

    on_rig(run_rig, scenario)


@pytest.mark.parametrize("late", [False, True])
def test_a_stop_given_in_the_same_moment_as_a_write_is_not_ended_from_the_control_room(run_rig, late):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        if late:
            # Otherwise there would be nothing to end, and no command.
            assert await control.write(at + 4, [1]) == 0
        stop = rig.control.stop("a hand in the gear", "ana")
        if late:
            # The stop comes between the writing of the register and the command.
            writing = asyncio.create_task(control.write(at + 4, [0]))
            await asyncio.sleep(0)
            await stop
            code = await writing
        else:
            await stop
            code = await control.write(at + 4, [0])
        assert code == 4
        assert rig.control.wishes.stop is not None

    on_rig(run_rig, scenario)


def test_reads_at_the_same_moment_share_one_snapshot(run_rig):
    async def scenario(rig, control):
        taken = []
        table = SunSpecTable(
            SunSpecMap("x", 1, {"tracker": 0.8}),
            lambda: taken.append(1) or rig.take_snapshot(),
            rig.clock.monotonic,
            writable=False,
        )
        for _ in range(100):
            table.read(3, BASE, 2)
        assert len(taken) == 1

    on_rig(run_rig, scenario)


def test_a_second_target_right_after_the_first_is_the_one_that_counts(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20
        assert await control.write(at, [*int32(3383), *int32(21701), 1]) == 0
        assert await control.write(at, [*int32(5000), *int32(15000), 1]) == 0
        # By then nobody waits for the effect of the first target.
        await asyncio.sleep(10)
        assert await control.read(at, 5) == (*int32(5000), *int32(15000), 1)
        assert await control.write(at + 4, [1]) == 0
        assert control.take_snapshot().trackers[0].wishes.hold.goto_deg is not None

    on_rig(run_rig, scenario)


def test_a_control_room_that_writes_the_same_every_second_gives_one_order(run_rig):
    async def scenario(rig, control):
        at = (await control.models())[601][0] + 20

        async def orders(values):
            before = len(told())
            for _ in range(20):
                assert await control.write(at, values) == 0
                await asyncio.sleep(1)
            return len(told()) - before

        def told():
            return [event.text for event in rig.records_of(Event) if event.subject == "operator"]

        block = [*int32(3383), *int32(21701), 1]
        assert await orders(block) == 1
        assert await control.read(at, 5) == tuple(block)
        assert await orders([0x8000, 0, 0x8000, 0, 1]) == 1
        assert await orders([0x8000, 0, 0x8000, 0, 0]) == 1
        await rig.until_mode(Mode.TRACKING, 60)
        assert await orders([0x8000, 0, 0x8000, 0, 0]) == 0
        # A person's command meanwhile replaces it, as always.
        await Operator(rig.service.trackers[0], 1.0).hold("a look", "ana")
        assert await orders(block) == 1

    on_rig(run_rig, scenario)


@pytest.mark.parametrize("values", [[0], [1], [*int32(9000), *int32(18000), 1]], ids=["auto", "hold", "goto"])
def test_a_hold_by_the_program_until_a_person_has_looked_is_not_ended_from_the_control_room(
    run_rig, monkeypatch, values
):
    monkeypatch.setattr(ServiceRig, "hold_why", "the program was changed")

    async def scenario(rig):
        await rig.until_mode(Mode.HOLD, 60)
        control = Control(rig)
        at = (await control.models())[601][0] + 20
        stood, held = rig.truth(), rig.control.wishes
        assert await control.write(at + 5 - len(values), values) == 4
        await asyncio.sleep(600)
        assert (rig.truth(), rig.control.wishes) == (stood, held)
        await control.server._end(None)

    run_rig(scenario)
