"""The bench in this process, on what no command line brings about in a short time."""

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
from sim_drivers.bench.client import request
from sim_drivers.weather_files import load_weather

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals"),
]
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
def test_a_weather_file_that_has_ended_under_a_bench_ends_it_in_a_sentence(tmp_path, caplog, ask):
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


def test_the_truth_in_a_gap_of_the_weather_lacks_the_light_alone(tmp_path):
    weather = weather_at(tmp_path, "10:00", "10:01", "13:00", "13:01")

    async def act():
        clock = LoopClock(asyncio.get_running_loop().time, weather.start_utc_s + 3600.0)
        stop, ready = asyncio.Event(), asyncio.Event()
        bench = asyncio.create_task(run_bench(Settings(), tmp_path, clock, weather, stop, lambda _ports: ready.set()))
        try:
            await ready.wait()
            return await asyncio.to_thread(request, tmp_path, "state", [])
        finally:
            stop.set()
            await bench

    state = asyncio.run(act())
    assert "has no weather for 2022-06-21T11:0" in state["light_missing"]
    assert (state["sky"], state["faces"], state["plane_of_array_w_m2"]) == (None, None, None)
    assert 60.0 < state["sun"]["elevation_deg"] < 65.0
    assert state["pose"] == pytest.approx({"a_deg": 0.0, "b_deg": 90.0})
    assert state["positioner"]["plugged"]
    assert state["load"]["truth"]["pmpp_w"] == 0.0
