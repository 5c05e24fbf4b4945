"""The availability topic after a crash, a restart and a clean stop of the program itself."""

import asyncio
import signal

import pytest

from tests.support import forks
from tests.support.addresses import free_port
from tests.support.mqtt import observer

pytestmark = pytest.mark.system

STATUS = "heliocube/tracker/status"


def test_it_is_true_after_a_crash_a_restart_and_a_clean_stop(broker, tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f"[simulation]\nspeed = 1.0\n[bridge]\nlisten = '127.0.0.1:0'\nsend_to = []\n"
        f"[api]\nlisten = '127.0.0.1:{free_port()}'\n[mqtt]\nenabled = true\nport = {broker.port}\nkeepalive_s = 2\n"
    )
    processes = []

    def start():
        with (tmp_path / "log").open("a") as log:
            processes.append(forks.start(["run", "--config", config], stdout=log, stderr=log))

    async def found_late():
        async with observer(broker.port, STATUS) as late:
            await late.until(STATUS)
            assert late.heard[0].retain
            return late.heard[0].payload

    async def scenario():
        async with observer(broker.port) as lab:
            start()
            await lab.until(STATUS, lambda word: word == "online")
            assert await found_late() == b"online"
            processes[-1].kill()
            await lab.until(STATUS, lambda word: word == "offline")
            assert await found_late() == b"offline"
            heard = len(lab.on(STATUS))
            start()
            await lab.until(STATUS, lambda word: word == "online", after=heard)
            assert await found_late() == b"online"
            heard = len(lab.on(STATUS))
            processes[-1].send_signal(signal.SIGTERM)
            await lab.until(STATUS, lambda word: word == "offline", after=heard)
            assert await found_late() == b"offline"
            assert await asyncio.to_thread(processes[-1].wait, 20) == 0
            assert "Traceback" not in (tmp_path / "log").read_text()

    try:
        asyncio.run(scenario())
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
            process.wait()
