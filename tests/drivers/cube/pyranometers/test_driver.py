"""The cube on simulated sensors: what a bad one costs the others, and that no sensor is taken for another."""

import asyncio
import contextlib
import math

import pytest

from drivers.errors import ConnectError, DriverHungError, LinkLostError
from sim_drivers.modbus.pyranometers import SimulatedApogee
from tests.drivers.cube.pyranometers.conftest import LIGHT

MAKES = ["smp", "hukseflux", "hukseflux-pv", "apogee", "eko-ms60s", "delta-ohm"]
TWO_LINES = {"line": "COM5", "west": {"line": "COM6"}, "zenith": {"line": "COM6"}}


def values(reading):
    return tuple(face.value for face in reading.faces)


def flaws(reading):
    return tuple(face.flaw for face in reading.faces)


@pytest.mark.parametrize("make", MAKES)
def test_every_make_is_read_by_day_and_by_night(on_rig, make):
    async def both(rig):
        day, _ = await rig.scans()
        rig.light[:] = [-2.0] * 4
        return day, (await rig.scans())[0]

    day, night = on_rig(both, make=make)
    assert values(day) == pytest.approx(LIGHT, abs=0.06)
    assert values(night) == pytest.approx((-2.0,) * 4)
    assert (day.unit, day.notes, day.rounded) == ("W/m2", (), True)


A_MAP = {"function": 4, "register_number": 7, "scale": 0.1}


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"make": "smp"}, "reports void data"),
        ({"make": "hukseflux"}, "has failed"),
        ({"make": "hukseflux-pv"}, "has failed"),
        ({"make": "apogee"}, "sends no number"),
        ({"make": "eko-ms60s"}, "sends no number"),
        ({"make": "delta-ohm"}, "reports status bits 0x0001"),
        ({"make": "map", "map": A_MAP | {"number_type": "float32"}}, "sends no number"),
        ({"make": "map", "map": A_MAP | {"number_type": "int16", "status_register": 9}}, "reports status bits 0xffff"),
        ({"make": "map", "map": A_MAP | {"number_type": "int16"}}, "has failed"),
    ],
)
def test_a_sensor_that_cannot_measure_gives_no_value_and_says_why(on_rig, keys, why):
    async def blind(rig):
        rig.light[1] = math.nan
        reading = (await rig.scans())[0]
        rig.light[1] = LIGHT[1]
        return reading, (await rig.scans(8))[0]

    reading, after = on_rig(blind, **keys)
    assert flaws(reading) == (None, "missing", None, None)
    assert math.isnan(reading.south.value)
    assert len(reading.notes) == 1
    assert why in reading.notes[0]
    assert values(after) == pytest.approx(LIGHT, abs=0.06)


def test_four_sensors_of_different_makes_and_configured_register_maps_are_read_on_one_line(on_rig):
    keys = {
        "make": "map",
        "map": {"function": 4, "register_number": 7, "number_type": "int16", "scale": 0.1, "status_register": 9},
        "south": {"make": "smp"},
        "west": {"make": "hukseflux"},
        "zenith": {"number_type": "float32", "word_order": "low-first", "register_number": 30, "scale": 1.0},
    }
    assert values(on_rig(lambda rig: rig.scans(), **keys)[0]) == pytest.approx(LIGHT, abs=0.06)


def test_each_face_has_its_own_instant(on_rig):
    reading, took_s = on_rig(lambda rig: rig.scans())
    instants = [face.time_monotonic_s for face in reading.faces]
    assert instants == sorted(set(instants))
    assert 0.0 < instants[-1] - instants[0] < took_s


def test_a_dead_sensor_delays_a_scan_by_at_most_0_3_s_and_later_only_every_fifth_scan_or_fewer(on_rig):
    async def dies(rig):
        _, well_s = await rig.scans(2)
        rig.sensors[1].silent = True
        first, first_s = await rig.scans()
        await rig.scans(40)
        slow = [took_s for took_s in [(await rig.scans())[1] for _ in range(60)] if took_s > well_s]
        return first, well_s, first_s, len(slow)

    first, well_s, first_s, slow = on_rig(dies)
    assert flaws(first) == (None, "late", None, None)
    assert values(first)[2:] == pytest.approx(LIGHT[2:])
    assert first_s - well_s <= 0.3
    # A sensor that has been silent for long is asked every half minute only, so most scans do not wait for it.
    assert slow <= 12


def test_a_sensor_that_comes_back_is_used_again(on_rig):
    async def returns(rig):
        rig.sensors[1].silent = True
        await rig.scans(20)
        silent = (await rig.scans(2))[0]
        rig.sensors[1].silent = False
        return silent, (await rig.scans(8))[0]

    silent, back = on_rig(returns)
    assert silent.notes == ("the south sensor (address 2) does not answer",)
    assert values(back) == pytest.approx(LIGHT)
    assert back.notes == ()


def test_a_sensor_that_was_silent_for_an_hour_is_asked_twice_a_minute(on_rig):
    async def silent(rig):
        rig.sensors[3].silent = True
        await rig.scans(60, every_s=60.0)
        rig.sensors[3].silent = False
        return (await rig.scans(every_s=29.0))[0], (await rig.scans(every_s=2.0))[0]

    before, after = on_rig(silent)
    assert flaws(before) == (None, None, None, "late")
    assert values(after) == pytest.approx(LIGHT)


def test_reopening_the_cube_forgets_the_missed_replies_of_a_silent_sensor(on_rig):
    async def opened_again(rig):
        rig.sensors[3].silent = True
        at_last = (await rig.scans(6))[0].notes
        await rig.cube.open()
        return at_last, (await rig.scans())[0].notes

    at_last, after_two = on_rig(opened_again)
    assert len(at_last) == 1
    assert "does not answer" in at_last[0]
    assert after_two == ()


def test_one_corrupt_reply_causes_no_note_and_no_pause_before_the_sensor_is_asked_again(on_rig):
    async def garbles(rig):
        rig.sensors[3].corrupt = 1
        return (await rig.scans())[0], (await rig.scans(every_s=0.1))[0]

    garbled, after = on_rig(garbles)
    assert flaws(garbled) == (None, None, None, "missing")
    assert garbled.notes == ()
    assert values(after) == pytest.approx(LIGHT)


@pytest.mark.parametrize("make", ["smp", "hukseflux", "map"])
def test_a_late_reply_is_never_taken_for_the_reply_to_another_question(on_rig, make):
    """The light changes with every scan, so an old reply would show."""

    async def late(rig):
        wrong = []
        for number in range(80):
            late_s = (0.31, 0.5, 5.05, 5.3)[number // 20]
            rig.sensors[0].delay_s = late_s if 5 <= number % 20 < 12 else 0.0
            rig.light[:] = [100.0 + 10 * number, 400.0, 200.0 + number, 500.0]
            reading, _ = await rig.scans(every_s=0.0)
            wrong += [
                (number, face, value)
                for face, value in enumerate(values(reading))
                if not math.isnan(value) and abs(value - rig.light[face]) > 0.06
            ]
            await asyncio.sleep(5.0 - rig.clock.monotonic() % 5.0)
        return wrong

    assert on_rig(late, make=make) == []


def test_swapped_sensors_are_refused_where_their_serial_numbers_are_pinned(on_rig):
    pinned = {"east": {"serial": 101}, "west": {"serial": 103}}

    async def swaps(rig):
        rig.cores[""].swap(0, 2)
        return (await rig.scans(8))[0]

    reading = on_rig(swaps, **pinned)
    assert flaws(reading) == ("missing", None, "missing", None)
    assert "the serial number 103, but 101 is configured" in reading.notes[0]
    assert len(reading.notes) == 2


@pytest.mark.parametrize("scans_before", range(1, 5))
def test_a_swap_of_pinned_sensors_between_two_scans_is_noticed_within_four_scans(on_rig, scans_before):
    async def swaps(rig):
        before = (await rig.scans(scans_before))[0]
        rig.cores[""].swap(0, 2)
        return before, (await rig.scans(4))[0]

    before, after = on_rig(swaps, east={"serial": 101}, west={"serial": 103})
    assert flaws(before) == (None, None, None, None)
    assert flaws(after) == ("missing", None, "missing", None)


def test_a_swap_of_sensors_that_are_not_pinned_is_not_seen(on_rig):
    async def swaps(rig):
        rig.cores[""].swap(0, 2)
        return (await rig.scans())[0]

    assert values(on_rig(swaps))[0] == pytest.approx(LIGHT[2])


def test_two_sensors_at_one_address_flaw_the_face_there_and_do_not_disturb_other_addresses(on_rig):
    async def doubles(rig):
        rig.sensors[1].address = 1
        return (await rig.scans(4))[0]

    reading = on_rig(doubles)
    assert flaws(reading)[0] is not None
    assert values(reading)[2:] == pytest.approx(LIGHT[2:])


@pytest.mark.parametrize(("mode", "status", "flaw"), [(3, 0, "missing"), (1, 1, "missing"), (1, 2, "over-range")])
def test_an_error_flag_or_a_wrong_mode_flaws_the_face_and_is_reported_in_a_note(on_rig, mode, status, flaw):
    async def flagged(rig):
        rig.sensors[0].mode, rig.sensors[0].status = mode, status
        return (await rig.scans())[0]

    reading = on_rig(flagged)
    assert flaws(reading) == (flaw, None, None, None)
    assert reading.notes[0].startswith("the east sensor (address 1) ")


def test_a_delta_ohm_sensor_is_late_while_it_boots_and_is_read_afterwards(on_rig):
    async def restarts(rig):
        rig.sensors[2].power_cycle(rig.clock.monotonic())
        return (await rig.scans())[0], (await rig.scans(5))[0]

    booting, up = on_rig(restarts, make="delta-ohm")
    assert flaws(booting) == (None, None, "late", None)
    assert flaws(up) == (None, None, None, None)


def test_with_one_of_two_lines_unplugged_the_other_is_read_and_the_lost_one_recovers(on_rig):
    async def pulled(rig):
        rig.lines["COM6"].link_up = False
        gone, _ = await rig.scans(3)
        rig.lines["COM6"].link_up = True
        return gone, (await rig.scans(10))[0]

    gone, back = on_rig(pulled, **TWO_LINES)
    assert flaws(gone) == (None, None, "missing", "missing")
    assert "cannot be reached: is not plugged in" in gone.notes[0]
    assert values(back) == pytest.approx(LIGHT)


def test_lines_are_read_at_the_same_time(on_rig):
    _, alone_s = on_rig(lambda rig: rig.scans(2))
    _, shared_s = on_rig(lambda rig: rig.scans(2), **TWO_LINES)
    assert shared_s < 0.6 * alone_s


def test_unplugging_the_only_line_of_the_cube_is_a_lost_link(on_rig):
    async def pulled(rig):
        rig.lines[""].link_up = False
        await rig.scans()

    with pytest.raises(LinkLostError, match="unplugged"):
        on_rig(pulled)


def test_a_line_with_a_hung_driver_ends_the_cube_only_when_no_other_line_is_left(on_rig):
    async def hung(_within_s=0.0):
        raise DriverHungError("cube", "8 calls of its driver never returned")

    async def scenario(rig):
        rig.lines["COM5"].link_up = False
        rig.lines["COM5"].open = hung
        half, _ = await rig.scans(3)
        rig.lines["COM6"].link_up = False
        for again in (rig.scans, rig.cube.open):
            with pytest.raises(DriverHungError, match="never returned"):
                await again()
        return half

    assert flaws(on_rig(scenario, **TWO_LINES)) == ("missing", "missing", None, None)


def test_a_cube_of_silent_sensors_is_a_lost_link_and_reopens_when_they_answer_again(on_rig):
    async def dark(rig):
        for sensor in rig.sensors:
            sensor.silent = True
        with pytest.raises(LinkLostError, match="no pyranometer answers"):
            await rig.scans()
        with pytest.raises(ConnectError, match="wires A and B"):
            await rig.cube.open()
        for sensor in rig.sensors:
            sensor.silent = False
        return await rig.cube.open()

    assert on_rig(dark).startswith("SMP3 no. 24101 of 2023, software 108, SMP3 no. 24102")


def test_a_sensor_of_another_kind_is_named_in_a_note(on_rig):
    async def other(rig):
        rig.sensors[0].kind = 613
        return (await rig.scans(2))[0]

    assert "SHP1 pyrheliometer" in on_rig(other).notes[0]


def test_a_missing_register_is_reported_with_a_hint_to_check_the_configured_make(on_rig):
    async def asked(rig):
        address, serial = rig.sensors[0].address, rig.sensors[0].serial
        rig.cores[""].sensors[0] = SimulatedApogee(address, serial, lambda _now: 1.0)
        return (await rig.scans(3))[0]

    reading = on_rig(asked, make="map", map={"register_number": 500})
    assert flaws(reading) == ("missing", None, None, None)
    assert "address 1 has no such register (exception 2): is it of the configured make?" in reading.notes[0]


@pytest.mark.parametrize(("keys", "flaw"), [({}, None), ({"east": {"serial": 101}}, "missing")])
def test_a_sensor_without_a_readable_serial_number_is_read_unless_a_number_is_pinned(on_rig, keys, flaw):
    async def hides(rig):
        east = rig.sensors[0]
        data = {register: word for register, word in east.registers(0.0).items() if register < 41}
        east.registers = lambda w_m2: data | {5: round(w_m2)}
        await rig.cube.open()
        return [flaws((await rig.scans(every_s=31.0))[0])[0] for _ in range(5)]

    assert on_rig(hides, **keys) == [flaw] * 5


def test_the_pyranometer_cube_sends_only_read_functions(on_rig):
    async def watched(rig):
        asked = []
        core = rig.cores[""]
        feed = core.feed
        core.feed = lambda data, now: (asked.append(data), feed(data, now))[1]
        await rig.cube.open()
        await rig.scans(10)
        return {frame[1] for frame in asked}

    assert on_rig(watched, make="hukseflux") <= {3, 4}


@pytest.mark.parametrize(("number_type", "longest_s"), [("int16", 0.6), ("float32", 5.05)])
def test_a_late_reply_of_a_logger_is_never_taken_for_another_face(on_rig, number_type, longest_s):
    """A logger has all four faces at one address, and a reply over RTU does not say which registers it is from."""
    registers = {
        face: {"address": 1, "register_number": 2 * number} for number, face in enumerate(("east", "south", "west"))
    }
    keys = {"zenith": {"address": 1, "register_number": 6}, "map": {"number_type": number_type}} | registers

    async def late(rig):
        wrong, right = [], 0
        for number in range(60):
            rig.sensors[0].delay_s = (0.31, 0.5, longest_s)[number // 20] if 5 <= number % 20 < 8 else 0.0
            rig.light[:] = [100.0 + number, 300.0 + number, 500.0 + number, 700.0 + number]
            try:
                reading, _ = await rig.scans(every_s=0.0)
            except LinkLostError:
                with contextlib.suppress(ConnectError):
                    await rig.cube.open()
                continue
            wrong += [
                (number, face, value)
                for face, value in enumerate(values(reading))
                if not math.isnan(value) and abs(value - rig.light[face]) > 0.6
            ]
            right += flaws(reading) == (None, None, None, None)
            await asyncio.sleep(5.0 - rig.clock.monotonic() % 5.0)
        return wrong, right

    wrong, right = on_rig(late, make="map", **keys)
    assert wrong == []
    assert right > 30
