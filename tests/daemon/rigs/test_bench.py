"""The bench in this process: cases that no command line brings about in a short time."""

import asyncio
import os
import socket
import sys

import pytest

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.simulated import run_bench
from drivers.modbus.framing import RtuClient, TcpClient
from drivers.modbus.pdu import READ_HOLDING, read_registers
from sim_drivers.bench.client import BenchError, request
from sim_drivers.weather import GeneratedWeather
from sim_drivers.weather_files import load_weather
from tests.system.processes import wait_until

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals"),
]
NOON_UTC_S = 1655812800.0
QUESTION = read_registers(1, READ_HOLDING, 0, 6)


def weather_at(tmp_path, *times):
    """Return weather of some instants of a day, HH:MM."""
    file = tmp_path / "weather.csv"
    file.write_text("time,ghi,dni,dhi\n" + "".join(f"2022-06-21T{time}Z,500,600,100\n" for time in times))
    return load_weather(file)


def ask_on_the_line(tmp_path, _ports):
    handle = os.open(tmp_path / "cube", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    os.write(handle, RtuClient().begin(QUESTION))
    return lambda: os.close(handle)


def ask_by_network(_tmp_path, ports):
    connection = socket.create_connection(("127.0.0.1", ports.modbus))
    connection.sendall(TcpClient().begin(QUESTION))
    return connection.close


@pytest.mark.parametrize("ask", [ask_on_the_line, ask_by_network])
def test_a_bench_whose_weather_file_has_ended_ends_with_one_clear_sentence(tmp_path, caplog, ask):
    weather = weather_at(tmp_path, "10:00", "10:01", "10:02")
    settings = Settings.model_validate({"instruments": {"cube": {"driver": "modbus-pyranometers"}}})
    leave = []

    async def act():
        clock = LoopClock(asyncio.get_running_loop().time, weather.end_utc_s + 60.0)
        bench = run_bench(
            settings,
            tmp_path,
            clock,
            weather,
            asyncio.Event(),
            lambda ports: leave.append(ask(tmp_path, ports)),
        )
        async with asyncio.timeout(60.0):
            await bench

    try:
        with pytest.raises(UserError, match="has no weather for 2022-06-21T10:"):
            asyncio.run(act())
    finally:
        for each in leave:
            each()
    assert not caplog.records


def on_a_bench(tmp_path, work, driver="multiplexed", weather=None, at_utc_s=NOON_UTC_S):
    """Return the result of `work`, which gets a function that asks a bench, and its ports."""
    settings = Settings.model_validate({"instruments": {"cube": {"driver": driver}}})
    sky = weather or GeneratedWeather("clear", settings.site.place(), 1)

    def ask(verb, *arguments):
        return request(tmp_path, verb, list(arguments))

    async def act():
        clock = LoopClock(asyncio.get_running_loop().time, at_utc_s)
        stop, ready = asyncio.Event(), asyncio.get_running_loop().create_future()
        bench = asyncio.create_task(run_bench(settings, tmp_path, clock, sky, stop, ready.set_result))
        try:
            return await asyncio.to_thread(work, ask, await ready)
        finally:
            stop.set()
            await bench

    return asyncio.run(act())


def test_the_bench_state_in_a_gap_of_the_weather_lacks_only_the_light(tmp_path):
    weather = weather_at(tmp_path, "10:00", "10:01", "13:00", "13:01")
    state = on_a_bench(
        tmp_path, lambda ask, _ports: ask("state"), weather=weather, at_utc_s=weather.start_utc_s + 3600.0
    )
    assert "has no weather for 2022-06-21T11:0" in state["light_missing"]
    assert (state["sky"], state["faces"], state["plane_of_array_w_m2"]) == (None, None, None)
    assert 60.0 < state["sun"]["elevation_deg"] < 65.0
    assert state["pose"] == pytest.approx({"a_deg": 0.0, "b_deg": 90.0})
    assert state["positioner"]["plugged"]
    assert state["load"]["truth"]["pmpp_w"] == 0.0


@pytest.mark.parametrize(
    ("device", "driver", "port"), [("cube", "modbus-pyranometers", "modbus"), ("server", "multiplexed", "ni_server")]
)
def test_a_bench_device_that_cannot_be_replugged_because_its_port_is_in_use_is_reported(
    tmp_path, caplog, device, driver, port
):
    def work(ask, ports):
        ask("unplug", device)
        with socket.create_server(("127.0.0.1", getattr(ports, port))):
            with pytest.raises(BenchError, match=r"^replug: .*in use"):
                ask("replug", device)
            ask("unplug", device, "0")
            wait_until(lambda: caplog.messages, "the word of a plug that stays out")
        ask("replug", device)
        return ask("state")

    state = on_a_bench(tmp_path, work, driver)
    (said,) = caplog.messages
    assert said.startswith(f"{device} is not plugged in again: ")
    assert state["cube" if device == "cube" else "multiplexer"]["serving" if device == "server" else "plugged"]


@pytest.mark.parametrize("device", ["voltmeter", "load", "positioner"])
def test_an_identity_that_an_instrument_cannot_send_is_refused_by_the_bench(tmp_path, device):
    def work(ask, _ports):
        for name in ("KEITHLEY \u20ac", "KEITHLEY\n"):
            with pytest.raises(BenchError, match=r"^identity: "):
                ask("identity", device, name)
        assert ask("identity", device, "29C3") is None

    on_a_bench(tmp_path, work)


def test_pyranometer_status_and_mode_are_refused_for_a_labjack_which_has_neither(tmp_path):
    def work(ask, _ports):
        for what in ("status", "mode"):
            with pytest.raises(BenchError, match=rf"^pyranometer: a T7 has no {what}"):
                ask("pyranometer", "east", what, "3")
        ask("pyranometer", "east", "silent")
        return ask("state")["cube"]["sensors"]

    assert [each["silent"] for each in on_a_bench(tmp_path, work, "labjack")] == [True]


def test_a_bench_device_whose_port_name_a_file_has_taken_stays_unplugged_and_leaves_the_file(tmp_path, caplog):
    file = tmp_path / "voltmeter"

    def work(ask, _ports):
        ask("unplug", "voltmeter", "0.5")
        file.write_text("somebody's own")
        wait_until(lambda: caplog.messages, "the word of a plug that stays out")
        with pytest.raises(BenchError, match="exists and is not a port of a bench"):
            ask("replug", "voltmeter")
        kept = file.read_text()
        file.unlink()
        return kept

    assert on_a_bench(tmp_path, work) == "somebody's own"
    (said,) = caplog.messages
    assert said.startswith(f"voltmeter is not plugged in again: {file} exists")
