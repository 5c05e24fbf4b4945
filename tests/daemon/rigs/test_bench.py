"""The bench in this process, on what no command line brings about in a short time."""

import asyncio
import os
import sys

import pytest

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.simulated import run_bench
from drivers.modbus.framing import RtuClient
from drivers.modbus.pdu import READ_HOLDING, read_registers
from sim_drivers.weather_files import load_weather


@pytest.mark.live
@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_weather_file_that_has_ended_under_a_bench_ends_it_in_a_sentence(tmp_path):
    file = tmp_path / "weather.csv"
    file.write_text("time,ghi,dni,dhi\n" + "".join(f"2022-06-21T10:0{at}Z,500,600,100\n" for at in range(3)))
    weather = load_weather(file)
    settings = Settings.model_validate({"instruments": {"cube": {"driver": "modbus-pyranometers"}}})
    handles = []

    def ask(_ports):
        handles.append(os.open(tmp_path / "cube", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        os.write(handles[0], RtuClient().begin(read_registers(1, READ_HOLDING, 0, 6)))

    async def act():
        clock = LoopClock(asyncio.get_running_loop().time, weather.end_utc_s + 60.0)
        await run_bench(settings, tmp_path, clock, weather, asyncio.Event(), ask)

    try:
        with pytest.raises(UserError, match="has no weather for 2022-06-21T10:"):
            asyncio.run(act())
    finally:
        for handle in handles:
            os.close(handle)
