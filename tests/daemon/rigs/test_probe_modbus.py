"""`heliocube probe cube` on simulated sensors: who answers, old errors, and new addresses one at a time."""

import asyncio

import pytest

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.rigs.probe_modbus import ModbusProbe, unit_range
from drivers.cube.pyranometers.settings import RegisterMapSettings
from drivers.errors import DeadlineError
from drivers.modbus.pdu import READ_HOLDING, READ_INPUT_REGISTERS
from sim_drivers.modbus.line import DeviceLineCore
from sim_drivers.modbus.pyranometers import SimulatedApogee, SimulatedHukseflux, SimulatedMapped, SimulatedSmp
from sim_drivers.transports import InMemoryModbus


def bright(_now_s):
    return 321.0


class Gateway(InMemoryModbus):
    """A gateway, which answers itself where a sensor does not."""

    async def exchange(self, request, within_s):
        try:
            return await super().exchange(request, within_s)
        except DeadlineError:
            return bytes((request.pdu[0] | 0x80, 11))


class Bus:
    """A line of simulated sensors, and what the probe has said about it."""

    path = InMemoryModbus

    def __init__(self, *sensors, **keys):
        self.core = DeviceLineCore(sensors)
        self.settings = Settings.model_validate({"instruments": {"cube": {"driver": "modbus-pyranometers", **keys}}})
        self.said = []

    def run(self, work):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            clock = LoopClock(runner.get_loop().time, 1.7e9)
            probe = ModbusProbe(
                self.settings,
                "COM5",
                clock,
                self.said.append,
                path=lambda _line: self.path("cube", self.core, clock.monotonic),
            )
            runner.run(work(probe))
        return "\n".join(self.said)


def test_the_probe_lists_the_sensors_that_answer_with_address_make_and_face():
    bus = Bus(
        SimulatedSmp(1, 101, bright),
        SimulatedHukseflux(3, 103, bright),
        SimulatedApogee(9, 0, bright),
        west={"serial": 7},
    )
    said = bus.run(lambda probe: probe.report(range(1, 11), clear=False))
    assert "address 1: SMP3 no. 101 of 2023, software 108: 321.00 W/m2; configured as the east face" in said
    assert "address 3: SR20-D2 no. 103: 321.00 W/m2; the west face is configured here, with serial number 7" in said
    assert "address 9: answers; its make is not known here" in said
    assert len(bus.said) == 4


def test_the_probe_reads_a_sensor_of_the_configured_make():
    bus = Bus(SimulatedApogee(2, 0, bright), make="apogee")
    assert "address 2: Apogee SP-500: 321.00 W/m2; configured as the south face" in bus.run(
        lambda probe: probe.report(range(1, 4), clear=False)
    )


def test_two_sensors_of_one_address_and_an_empty_line_are_each_reported_with_a_likely_cause():
    bus = Bus(SimulatedSmp(1, 101, bright), SimulatedSmp(1, 102, bright))
    assert "garbage: are there two" in bus.run(lambda probe: probe.report(range(1, 3), clear=False))
    assert "A and B the right way round" in Bus().run(lambda probe: probe.report(range(1, 3), clear=False))


def test_addresses_that_a_gateway_does_not_reach_are_not_listed():
    bus = Bus(SimulatedSmp(1, 101, bright))
    bus.path = Gateway
    said = bus.run(lambda probe: probe.report(range(1, 6), clear=False))
    assert "address 1: SMP3 no. 101" in said
    assert len(bus.said) == 2, said


@pytest.mark.parametrize(
    ("sensor", "who"),
    [(SimulatedSmp, "SMP3 no. 102 of 2023, software 108"), (SimulatedHukseflux, "SR20-D2 no. 102")],
)
def test_a_configured_sensor_that_misses_each_question_once_is_found_all_the_same(sensor, who):
    bus = Bus(sensor(2, 102, bright), sensor(9, 109, bright))
    feed, missed = bus.core.feed, []

    def deaf_at_first(data, now):
        if data not in missed:
            missed.append(data)
            return []
        return feed(data, now)

    bus.core.feed = deaf_at_first
    said = bus.run(lambda probe: probe.report(range(1, 11), clear=False))
    assert f"address 2: {who}: 321.00 W/m2; configured as the south face" in said
    assert "address 9" not in said, "where nobody is expected one question is enough: there may be 247 addresses"


def test_an_old_error_is_cleared_only_when_asked_for():
    sensor = SimulatedSmp(1, 101, bright)
    sensor.status = 8
    assert "--clear" in Bus(sensor).run(lambda probe: probe.report(range(1, 2), clear=False))
    assert sensor.status == 8
    assert "error 9 cleared" in Bus(sensor).run(lambda probe: probe.report(range(1, 2), clear=True))
    assert sensor.status == 0


def test_a_sensor_that_is_silent_when_its_error_is_to_be_cleared_is_named():
    bus = Bus(SimulatedSmp(1, 101, bright))

    class Said(list):
        def append(self, line):
            super().append(line)
            if "address 1:" in line:
                bus.core.sensors.clear()

    bus.said = Said()
    with pytest.raises(DeadlineError, match=r"^cube: address 1 no longer answers: is it still on\?"):
        bus.run(lambda probe: probe.report(range(1, 2), clear=True))


class Person:
    """Connects one sensor after another, switches it off and on when asked, and gives the answers of a test."""

    def __init__(self, bus, sensors, **answers):
        self.bus, self.sensors, self.answers = bus, iter(sensors), answers
        self.asked = []

    def __call__(self, question):
        self.asked.append(question)
        if question.startswith("Connect"):
            self.bus.core.sensors[:] = next(self.sensors)
            return "" if self.bus.core.sensors else "s"
        if question.startswith("Give"):
            return self.answers.get("first", "yes")
        if question.startswith("Type"):
            return self.answers.get("second", question.split("(")[1].split(")")[0])
        self.bus.core.power_cycle(0.0)
        return ""


def test_four_new_sensors_get_their_addresses_one_at_a_time():
    new = [SimulatedHukseflux(1, 101 + face, bright) for face in range(4)]
    bus = Bus(make="hukseflux")
    person = Person(bus, [[each] for each in new])
    said = bus.run(lambda probe: probe.set_addresses(person, range(1, 9)))
    assert [sensor.address for sensor in new] == [1, 2, 3, 4]
    assert "it has the address 1 already" in said
    assert said.count("it answers at") == 3
    assert "pin it: serial = 104 in [instruments.cube.zenith]" in said
    assert sum(question.startswith(("Give", "Type")) for question in person.asked) == 6


@pytest.mark.parametrize("answers", [{"first": "no"}, {"second": "9"}])
def test_no_address_is_written_unless_it_was_confirmed_twice(answers):
    new = SimulatedHukseflux(9, 101, bright)
    bus = Bus(make="hukseflux")
    bus.run(lambda probe: probe.set_addresses(Person(bus, [[new], [], [], []], **answers), range(1, 11)))
    assert new.stored_address == 9


def test_a_sensor_that_is_silent_when_its_address_is_written_is_named():
    bus = Bus(make="hukseflux")

    class Unplugging(Person):
        def __call__(self, question):
            answer = super().__call__(question)
            if question.startswith("Type"):
                bus.core.sensors.clear()
            return answer

    person = Unplugging(bus, [[SimulatedHukseflux(7, 101, bright)]])
    with pytest.raises(DeadlineError, match=r"^cube: address 7 no longer answers"):
        bus.run(lambda probe: probe.set_addresses(person, range(1, 9)))


@pytest.mark.parametrize(
    ("there", "why"),
    [
        ([], "nothing answers at 1"),
        ([SimulatedHukseflux(1, 555, bright)], "another sensor answers at 1: it has the serial number 555, not 101"),
        (
            [SimulatedHukseflux(1, 101, bright), SimulatedHukseflux(1, 555, bright)],
            "the answer at 1 is garbage: leave one sensor on the line, not two",
        ),
    ],
    ids=["nothing", "another one", "two"],
)
def test_after_a_write_the_probe_says_why_it_does_not_find_the_sensor_at_its_new_address(there, why):
    bus = Bus(make="hukseflux")

    class Confusing(Person):
        def __call__(self, question):
            answer = super().__call__(question)
            if question.startswith("Written"):
                bus.core.sensors[:] = there
            return "n" if question.startswith("Try") else answer

    person = Confusing(bus, [[SimulatedHukseflux(7, 101, bright)], [], [], []])
    said = bus.run(lambda probe: probe.set_addresses(person, range(1, 9)))
    assert f"  {why}\n" in said
    assert "it answers at" not in said


def test_with_two_new_sensors_on_the_line_at_once_no_address_is_written():
    new = [SimulatedHukseflux(5, 101, bright), SimulatedHukseflux(6, 102, bright)]
    bus = Bus(make="hukseflux")
    said = bus.run(lambda probe: probe.set_addresses(Person(bus, [new, [], [], [], []]), range(1, 9)))
    assert "2 devices answer, at 5, 6: take the others off" in said
    assert [sensor.stored_address for sensor in new] == [5, 6]


USED = {"register_number": 2, "number_type": "int16", "address_register": 9}


@pytest.mark.parametrize(
    "new",
    [
        [
            SimulatedMapped(1, 101, lambda _now_s: 99.0, RegisterMapSettings(**USED)),
            SimulatedMapped(1, 102, bright, RegisterMapSettings(**USED)),
        ],
        [SimulatedHukseflux(5, 101, bright), SimulatedHukseflux(5, 102, bright)],
    ],
)
def test_with_two_sensors_of_one_address_on_the_line_at_once_no_new_address_is_offered(new):
    bus = Bus(make="map", map=USED)
    person = Person(bus, [new, [], [], [], []])
    said = bus.run(lambda probe: probe.set_addresses(person, range(1, 9)))
    assert f"the answer at {new[0].address} is garbage: leave one sensor on the line, not two" in said
    assert "already" not in said
    assert not [question for question in person.asked if question.startswith("Give")]


@pytest.mark.parametrize(
    ("sensor", "make", "why"),
    [(SimulatedSmp(9, 101, bright), "smp", "Smart Explorer"), (SimulatedApogee(9, 0, bright), "apogee", "calibration")],
)
def test_for_a_make_without_an_address_register_the_probe_writes_nothing_and_says_why(sensor, make, why):
    bus = Bus(make=make)
    feed, functions = bus.core.feed, []
    bus.core.feed = lambda data, now: (functions.append(data[1]), feed(data, now))[1]
    person = Person(bus, [[sensor], [], [], []])
    said = bus.run(lambda probe: probe.set_addresses(person, range(1, 11)))
    assert why in said
    assert not [question for question in person.asked if not question.startswith("Connect")]
    assert functions
    assert set(functions) <= {READ_HOLDING, READ_INPUT_REGISTERS}


def test_a_wrong_address_range_or_another_cube_driver_is_refused_in_one_sentence():
    with pytest.raises(UserError, match="1 to 247"):
        unit_range("0-300")
    with pytest.raises(UserError, match='only the cube "modbus-pyranometers"'):
        ModbusProbe(Settings(), "COM5", None, print)
