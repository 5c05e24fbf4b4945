"""One sensor and one line, question by question: when they are asked again, and what is reported meanwhile."""

import asyncio
import math

import pytest

from drivers.cube.pyranometers.driver import SensorLine
from drivers.cube.pyranometers.makes import Block, SensorIdentity, SensorReading
from drivers.cube.pyranometers.sensor import BusSensor
from drivers.errors import ConnectError, DeadlineError, LinkLostError, RefusedError, UnavailableError

DATA, PROOF, LONG_PROOF = Block(3, 0, 1), Block(3, 40, 1), Block(3, 40, 2)


class Make:
    """A make whose one register is the irradiance itself."""

    data = DATA
    more = ()

    def __init__(self, proof):
        self.proof = proof

    def identify(self, proof, *_more):
        return SensorIdentity(f"no. {proof[0]}", proof[0])

    def serial(self, proof):
        return proof[0]

    def decode(self, data):
        return SensorReading(float(data[0]))


class Bus:
    """Answers with the irradiance or the serial number, or raises the error of a test."""

    def __init__(self):
        self.wrong = self.shut = None
        self.light, self.serial = 500, 7
        self.asked, self.opened_s = [], []
        self.now_s = 1000.0

    async def read(self, unit, function, register, length, within_s):
        self.asked.append((self.now_s - 1000.0, register))
        if self.wrong is not None:
            raise self.wrong
        return (self.light,) if register == DATA.register else (self.serial,) * length

    async def open(self, _within_s):
        self.opened_s.append(self.now_s - 1000.0)
        if self.shut is not None:
            raise self.shut

    async def close(self):
        pass

    def sensor(self, proof=LONG_PROOF, pinned=None):
        return BusSensor("south", 2, Make(proof), pinned, self, 0.2, lambda: 1.7e9, lambda: self.now_s)

    def reads(self, sensor, seconds=1, *, check=False):
        """Read every second, and return the last sample."""

        async def all_of_them():
            for _ in range(seconds):
                sample = await sensor.read(check=check)
                self.now_s += 1.0
            return sample

        return asyncio.run(all_of_them())


SILENT = DeadlineError("cube", "")


def test_a_silent_sensor_is_asked_ever_more_rarely_and_then_every_30_s_for_ever():
    bus = Bus()
    sensor = bus.sensor()
    bus.wrong = SILENT
    bus.reads(sensor, 170)
    assert [at_s for at_s, _ in bus.asked] == [0, 1, 6, 16, 36, 66, 96, 126, 156]
    bus.reads(sensor, 3600)
    assert bus.asked[-1][0] - bus.asked[-2][0] == 30.0
    bus.asked.clear()
    sensor.begin()
    bus.reads(sensor)
    assert bus.asked, "with a new connection it is asked at once"


def test_a_silent_sensor_is_reported_from_the_third_missed_reply_on():
    bus = Bus()
    sensor = bus.sensor()
    assert bus.reads(sensor).value == 500.0
    assert (sensor.answers, sensor.identity) == (True, "no. 7")
    bus.wrong = SILENT
    for said in ("", "", "the south sensor (address 2) does not answer"):
        bus.now_s += 100.0
        sample = bus.reads(sensor)
        assert (sample.flaw, sensor.answers, sensor.note) == ("late", False, said)
        assert math.isnan(sample.value)
    assert bus.reads(sensor).flaw == "late", "while it is left alone too"
    bus.wrong = None
    bus.now_s += 100.0
    assert bus.reads(sensor).value == 500.0
    assert (sensor.answers, sensor.note) == (True, "")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (RefusedError("cube", "has no such register"), "has no such register: is it of the configured make?"),
        (None, "has the serial number 8, but 7 is configured"),
    ],
)
def test_a_sensor_with_a_missing_register_or_a_wrong_serial_number_is_reported_at_once(wrong, said):
    bus = Bus()
    sensor = bus.sensor(pinned=7)
    bus.wrong, bus.serial = wrong, 8
    sample = bus.reads(sensor)
    assert (sample.flaw, sensor.answers) == ("missing", True)
    assert said in sensor.note


def test_a_garbled_answer_of_a_sensor_is_not_reported_as_silence():
    bus = Bus()
    sensor = bus.sensor()
    bus.wrong = DeadlineError("cube", "sent something that is not an answer")
    assert bus.reads(sensor, 40).flaw == "missing"
    assert sensor.note == "the south sensor (address 2) answers, but sent something that is not an answer"


def test_a_busy_sensor_is_reported_from_the_third_miss_on_without_doubt_about_its_make():
    bus = Bus()
    sensor = bus.sensor()
    bus.wrong = UnavailableError("cube", "address 2 is busy (exception 6)")
    for said in ("", "", "the south sensor (address 2) does not answer: address 2 is busy (exception 6)"):
        bus.now_s += 100.0
        assert bus.reads(sensor).flaw == "missing"
        assert (sensor.answers, sensor.note) == (False, said)


def test_a_sensor_on_a_lost_line_counts_as_silent_and_is_identified_anew_before_it_is_read():
    bus = Bus()
    sensor = bus.sensor()
    bus.reads(sensor)
    assert sensor.lost("cannot be reached: it is gone").flaw == "missing"
    assert not sensor.answers
    assert sensor.note == "the south sensor (address 2) cannot be reached: it is gone"
    bus.asked.clear()
    bus.reads(sensor)
    assert [register for _, register in bus.asked] == [PROOF.register, DATA.register]


@pytest.mark.parametrize(("proof", "flaw"), [(LONG_PROOF, None), (PROOF, "late"), (None, "late")])
def test_the_first_reply_after_a_miss_is_used_only_if_a_late_reply_would_look_different(proof, flaw):
    bus = Bus()
    sensor = bus.sensor(proof)
    bus.reads(sensor)
    bus.wrong = SILENT
    bus.reads(sensor)
    bus.wrong = None
    assert bus.reads(sensor).flaw == flaw
    assert bus.reads(sensor).flaw is None


def test_the_first_reply_on_a_reopened_line_is_not_used_if_it_may_be_a_late_one():
    bus = Bus()
    sensor = bus.sensor(None)
    sensor.begin()
    assert bus.reads(sensor).flaw == "late"
    assert bus.reads(sensor).value == 500.0


@pytest.mark.parametrize(("check", "pinned", "asked"), [
    (True, 7, [PROOF.register, DATA.register]), (True, None, [DATA.register]), (False, 7, [DATA.register]),
])  # fmt: skip
def test_a_pinned_serial_number_is_read_again_only_in_a_scan_that_checks_it(check, pinned, asked):
    bus = Bus()
    sensor = bus.sensor(pinned=pinned)
    bus.reads(sensor)
    bus.asked.clear()
    bus.reads(sensor, check=check)
    assert [register for _, register in bus.asked] == asked


def test_an_exchanged_sensor_is_noticed_within_as_many_scans_as_its_line_has_sensors():
    for place in range(4):
        buses = [Bus() for _ in range(4)]
        sensors = [(face, bus.sensor(pinned=7)) for face, bus in enumerate(buses)]
        line = SensorLine(buses[0], sensors, 2.0, lambda bus=buses[0]: bus.now_s)

        async def scans(line=line, bus=buses[place], place=place):
            await line.open()
            await line.read()
            bus.serial = 8
            return [dict(await line.read())[place].flaw for _ in range(4)]

        assert "missing" in asyncio.run(scans())


def test_a_line_that_does_not_open_is_tried_ever_more_rarely_until_it_does():
    bus = Bus()
    line = SensorLine(bus, [(1, bus.sensor())], 2.0, lambda: bus.now_s)
    bus.shut = ConnectError("cube", "is not there")

    async def seconds(count):
        for _ in range(count):
            found = await line.read()
            bus.now_s += 1.0
        return found

    ((face, sample),) = asyncio.run(seconds(100))
    assert bus.opened_s == [0, 2, 6, 14, 30, 60, 90]
    assert (face, sample.flaw, line.why_not) == (1, "missing", "is not there")
    bus.shut = None
    ((_, sample),) = asyncio.run(seconds(25))
    assert (sample.value, line.is_open, line.why_not) == (500.0, True, "")
    bus.wrong, bus.shut = LinkLostError("cube", "it is gone"), ConnectError("cube", "is not there")
    bus.opened_s.clear()
    began_s = bus.now_s - 1000.0
    asyncio.run(seconds(8))
    assert [at_s - began_s for at_s in bus.opened_s] == [2.0, 6.0], "the pauses begin anew"


def test_a_line_that_was_closed_is_opened_again_before_it_is_read():
    bus = Bus()
    line = SensorLine(bus, [(1, bus.sensor())], 2.0, lambda: bus.now_s)

    async def scenario():
        await line.read()
        await line.close()
        bus.now_s += 5.0
        return line.is_open, await line.read()

    was_open, ((_, sample),) = asyncio.run(scenario())
    assert (was_open, bus.opened_s, sample.value) == (False, [0, 5], 500.0)
