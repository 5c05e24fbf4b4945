"""The availability topic after a crash, a restart and a clean stop of the program itself."""

import asyncio
import signal
from datetime import UTC, datetime

import pytest

from tests.support import forks
from tests.support.addresses import free_port
from tests.support.mqtt import needs_mosquitto, observer

pytestmark = pytest.mark.system

STATUS = "heliocube/tracker/status"


@pytest.fixture
def processes():
    made = []
    yield made
    for process in made:
        if process.poll() is None:
            process.kill()
        process.wait()


@pytest.fixture
def start(broker, tmp_path, processes):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f"[simulation]\nspeed = 1.0\n[bridge]\nlisten = '127.0.0.1:0'\nsend_to = []\n"
        f"[api]\nlisten = '127.0.0.1:{free_port()}'\n[mqtt]\nenabled = true\nport = {broker.port}\nkeepalive_s = 2\n"
    )

    def start_one():
        with (tmp_path / "log").open("a") as log:
            processes.append(forks.start(["run", "--config", config], stdout=log, stderr=log))

    return start_one


@needs_mosquitto
def test_a_service_that_resumes_obeys_only_dated_commands_and_stops_sent_while_it_was_suspended(
    broker, start, processes
):
    async def scenario():
        async with observer(broker.port) as lab:
            start()
            await lab.until("heliocube/tracker/scan")
            processes[-1].send_signal(signal.SIGSTOP)
            await lab.publish("heliocube/tracker/command/hold", {"id": "of unknown age"})
            now = datetime.now(UTC).isoformat()
            await lab.publish("heliocube/tracker/command/snow", {"id": "dated", "time": now})
            await lab.publish("heliocube/tracker/command/stop", {"id": "a stop"})
            await lab.until(STATUS, lambda word: word == "offline")
            processes[-1].send_signal(signal.SIGCONT)
            reply = {
                name: await lab.until("heliocube/tracker/reply", lambda reply, name=name: reply["id"] == name)
                for name in ("of unknown age", "dated", "a stop")
            }
            assert reply["of unknown age"]["accepted"] is False
            assert "its age is not known" in reply["of unknown age"]["text"]
            assert reply["dated"]["accepted"] is reply["a stop"]["accepted"] is True

    asyncio.run(scenario())


def test_the_availability_topic_is_right_after_a_crash_a_restart_and_a_clean_stop(broker, tmp_path, start, processes):
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
            heard = len(lab.messages_on(STATUS))
            start()
            await lab.until(STATUS, lambda word: word == "online", after=heard)
            assert await found_late() == b"online"
            heard = len(lab.messages_on(STATUS))
            processes[-1].send_signal(signal.SIGTERM)
            await lab.until(STATUS, lambda word: word == "offline", after=heard)
            assert await found_late() == b"offline"
            assert await asyncio.to_thread(processes[-1].wait, 20) == 0
            assert "Traceback" not in (tmp_path / "log").read_text()

    asyncio.run(scenario())
