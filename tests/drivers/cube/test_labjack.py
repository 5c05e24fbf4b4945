"""Four inputs of a LabJack: on a foreign server, on the simulated one, and on devices that are not a LabJack."""

import asyncio
import math

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

import sim_drivers.modbus.labjack
from daemon.base.clock import LoopClock, SystemClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.file import ConfigError, load_settings
from drivers.cube.labjack import LabjackSettings, build
from drivers.errors import IdentityError, LinkLostError, ProtocolError
from drivers.settings import CubeSurroundings, SettingsError
from sim_drivers.modbus.labjack import SimulatedLabjack
from sim_drivers.modbus.line import DeviceLineCore
from sim_drivers.transports import InMemoryModbus

VOLTS = {0: 0.030, 2: 0.041, 4: 0.006, 6: 0.047}


def test_four_labjack_inputs_are_set_up_and_read_on_a_pymodbus_server():
    inputs = [value for pair in zip(VOLTS.values(), [0.0] * 4, strict=True) for value in pair]
    registers = [
        SimData(0, values=inputs, datatype=DataType.FLOAT32),
        SimData(40000, values=[10.0] * 8, datatype=DataType.FLOAT32),
        SimData(41000, values=[199] * 8, datatype=DataType.REGISTERS),
        SimData(41500, values=[0] * 8, datatype=DataType.REGISTERS),
        SimData(42000, values=[500.0] * 8, datatype=DataType.FLOAT32),
        SimData(55100, values=[0x0011, 0x2233], datatype=DataType.REGISTERS),
        SimData(60000, values=[7.0], datatype=DataType.FLOAT32),
        SimData(60028, values=[470012345], datatype=DataType.UINT32),
    ]

    async def work():
        server = ModbusTcpServer([SimDevice(id=1, simdata=registers)], address=("127.0.0.1", 0))
        await server.listen()
        port = server.transport.sockets[0].getsockname()[1]
        clock = SystemClock()
        cube = build(
            LabjackSettings(line=f"tcp:127.0.0.1:{port}", range_v=0.1),
            CubeSurroundings(clock.utc, clock.monotonic, 5.0, lambda: None),
        )
        try:
            identity, reading = await cube.open(), await cube.read()
            ranges = await server.async_getValues(1, 3, 40000, 2)
            negative = await server.async_getValues(1, 3, 41004, 1)
            settling = await server.async_getValues(1, 3, 42008, 2)
        finally:
            await cube.close()
            await server.shutdown()
        with pytest.raises(LinkLostError):
            await cube.read()
        return identity, reading, ranges, negative, settling

    identity, reading, ranges, negative, settling = asyncio.run(work())
    assert identity == "LabJack T7 no. 470012345"
    assert [face.value for face in reading.faces] == pytest.approx(list(VOLTS.values()))
    assert (reading.unit, reading.rounded) == ("V", True)
    assert ranges == [0x3DCC, 0xCCCD]
    assert negative == [5]
    assert settling == [0, 0]


def on_simulated(work, **keys):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        clock = LoopClock(runner.get_loop().time, 1.7e9)
        device = SimulatedLabjack(lambda each, _now: VOLTS.get(each, 0.0))
        path = InMemoryModbus("cube", DeviceLineCore([device]), clock.monotonic)
        around = CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None)
        cube = build(LabjackSettings(**keys), around, lambda _line: path)
        return runner.run(work(cube, device))


async def read(cube, _device):
    await cube.open()
    return await cube.read()


def test_the_simulated_labjack_reads_with_the_resolution_of_its_range():
    volts = [face.value for face in on_simulated(read, range_v=0.1).faces]
    assert volts == pytest.approx(list(VOLTS.values()), abs=0.1 / 2**15)
    assert volts != list(VOLTS.values())


def test_a_labjack_can_be_reopened_while_open_and_a_scan_takes_less_than_half_a_second():
    async def work(cube, device):
        await cube.open()
        faces = (await read(cube, device)).faces
        return faces[3].time_monotonic_s - faces[0].time_monotonic_s

    assert 0.0 <= on_simulated(work) < 0.5


def test_a_voltage_beyond_the_range_of_the_labjack_is_over_range():
    faces = on_simulated(read, range_v=0.01).faces
    assert [face.flaw for face in faces] == ["over-range", "over-range", None, "over-range"]


def test_an_input_that_cannot_be_measured_gives_no_value(monkeypatch):
    monkeypatch.setitem(VOLTS, 2, math.nan)
    faces = on_simulated(read).faces
    assert [face.flaw for face in faces] == [None, "over-range", None, None]


@pytest.mark.parametrize(("name", "value", "error"), [("product", 4, IdentityError), ("address", 2, LinkLostError)])
def test_opening_fails_with_another_labjack_product_or_another_device_address(name, value, error):
    async def work(cube, device):
        setattr(device, name, value)
        with pytest.raises(error):
            await cube.open()

    on_simulated(work)


def test_a_device_that_sends_its_words_in_another_order_is_refused(monkeypatch):
    monkeypatch.setattr(sim_drivers.modbus.labjack, "TEST_WORDS", (0x2233, 0x0011))

    async def work(cube, _device):
        with pytest.raises(IdentityError, match="sends its words in another order"):
            await cube.open()

    on_simulated(work)


def test_the_labjack_driver_uses_the_line_of_its_settings():
    clock, lines = SystemClock(), []
    around = CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None)
    for line in ("tcp:192.168.1.60:502", None):
        build(LabjackSettings(line=line), around, lambda each: lines.append(each))
    assert lines == ["tcp:192.168.1.60:502", ""]
    assert list(LabjackSettings(line="tcp:192.168.1.60:502").conflicts()) == []


def test_odd_inputs_are_accepted_by_a_t8_and_refused_by_a_t7():
    async def work(cube, device):
        with pytest.raises(ProtocolError, match="3 is odd"):
            await cube.open()
        become_t8(device)
        return await cube.open()

    assert on_simulated(work, inputs=(0, 3, 4, 6)).startswith("LabJack T8")


def test_inputs_from_8_on_are_accepted_by_a_t7_and_refused_by_a_t8():
    async def work(cube, device):
        identity = await cube.open()
        await cube.close()
        become_t8(device)
        with pytest.raises(ProtocolError, match="has the inputs 0 to 7, and not 8"):
            await cube.open()
        return identity

    assert on_simulated(work, inputs=(0, 2, 8, 12)).startswith("LabJack T7")


def become_t8(device):
    device.product = 8
    device.power_cycle(0.0)


@pytest.mark.parametrize(("range_v", "wider_v"), [(0.01, 0.018), (0.1, 0.15), (1.0, 1.2), (10.0, 11.0)])
def test_a_t8_measures_in_its_next_wider_range(range_v, wider_v):
    async def work(cube, device):
        become_t8(device)
        await cube.open()
        return device.state()["range_v"][:7:2]

    assert on_simulated(work, range_v=range_v) == [wider_v] * 4


def test_an_input_that_a_t8_does_not_have_is_refused_by_its_number():
    async def work(cube, device):
        become_t8(device)
        with pytest.raises(ProtocolError, match="has the inputs 0 to 7, and not 8"):
            await cube.open()

    on_simulated(work, inputs=(0, 2, 4, 8))


def test_a_resolution_index_that_the_labjack_does_not_take_is_reported():
    async def work(cube, _device):
        with pytest.raises(ProtocolError, match="does not take the resolution index 13 of AIN0"):
            await cube.open()

    on_simulated(work, resolution_index=13)


async def read_often(cube):
    for _ in range(16):
        await cube.read()


SETTINGS_OF_AIN4 = [(40008, "range"), (41004, "negative channel"), (41504, "resolution"), (42008, "settling time")]


@pytest.mark.parametrize(("register", "name"), SETTINGS_OF_AIN4)
def test_a_setting_that_the_labjack_does_not_keep_is_reported_by_name(register, name, monkeypatch):
    def write(device, function, at, values):
        if at != register:
            keep(device, function, at, values)

    async def work(cube, device):
        device.write(16, 42008, (0x43FA, 0))
        monkeypatch.setattr(SimulatedLabjack, "write", write)
        with pytest.raises(ProtocolError, match=f"did not keep the {name}.* of AIN4"):
            await cube.open()

    keep = SimulatedLabjack.write
    on_simulated(work)


@pytest.mark.parametrize(("register", "name"), SETTINGS_OF_AIN4)
def test_a_setting_that_another_program_changes_ends_the_readings(register, name):
    others = {40008: (0x4120, 0), 41004: (199,), 41504: (1,), 42008: (0x43FA, 0)}

    async def work(cube, device):
        await cube.open()
        device.write(16, register, others[register])
        with pytest.raises(LinkLostError, match=f"the {name}.* of AIN4 has changed"):
            await read_often(cube)
        await cube.open()
        await cube.read()

    on_simulated(work)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("inputs = [0, 2, 2, 6]", "instruments.cube.inputs = [0, 2, 2, 6]: has an input twice; each face needs one"),
        ("line = 'COM5'", 'instruments.cube.line = "COM5": is a serial port; a LabJack is in the network'),
        ("line = 'rtu-over-tcp:h:1'", "is not Modbus TCP"),
    ],
)
def test_a_mistake_in_the_labjack_configuration_is_refused_in_one_sentence(tmp_path, text, line):
    path = tmp_path / "wrong.toml"
    path.write_text(f"[instruments.cube]\ndriver = 'labjack'\n{text}\n")
    with pytest.raises(ConfigError) as caught:
        load_settings(path)
    (problem,) = caught.value.problems
    assert line in problem


def test_a_labjack_without_a_line_is_refused_with_the_key_to_set():
    clock = SystemClock()
    with pytest.raises(SettingsError, match=r"instruments\.cube\.line is missing: name the LabJack"):
        build(LabjackSettings(), CubeSurroundings(clock.utc, clock.monotonic, 5.0, lambda: None))


@pytest.mark.parametrize("inputs", [(0, 2, 4), (0, 2, 4, 6, 8)])
def test_a_number_of_inputs_other_than_four_is_refused(inputs):
    with pytest.raises(ValueError, match="4 items"):
        LabjackSettings(inputs=inputs)
