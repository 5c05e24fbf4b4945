"""People are also told of a service that does not answer, or in whose place something else answers."""

import asyncio
import json
import re
from pathlib import Path

import httpx
import pytest
from pydantic import ValidationError

from daemon.base.addresses import parse_address
from daemon.base.clock import LoopClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier
from tests.daemon.notify.test_courier import NOON_UTC_S, Way, lab, told

__all__ = ["lab", "told"]

pytestmark = pytest.mark.slow

ROOF = '{"site": {"name": "roof"}, "simulated": true, "trackers": {}'


def test_a_silent_service_is_reported_once_and_its_return_is_reported_too(lab, told):
    async def scenario(step):
        await step()
        lab.up = False
        for _ in range(15):
            await step()
        ((_, _, body),) = lab.told
        found = json.loads(body)
        assert found["title"].endswith("CRITICAL does not answer")
        assert f"The service at {lab.address} has not answered for 120 s: it answers with 503." in found["message"]
        lab.up = True
        await step()
        assert lab.titles[1].endswith(": answers again")

    told(scenario)


@pytest.mark.parametrize(
    "page",
    [
        "<html>",
        "{}",
        "[]",
        '{"error": "x"}',
        ROOF + "}",
        ROOF + ', "alarms": [{"name": "x", "tracker": null, "severity": "fatal"}]}',
        ROOF
        + ', "alarms": [{"name": "x", "tracker": null, "severity": "critical", "state": "raised", "raised_at": []}]}',
        "[" * 100_000,
    ],
    ids=range(8),
)
def test_another_program_that_answers_in_place_of_the_service_is_reported_like_silence(lab, told, page):
    async def scenario(step):
        lab.instead = page.encode()
        for _ in range(15):
            await step()
        assert "for 120 s: the program that answers there is not heliocube." in json.loads(lab.told[0][2])["message"]
        lab.instead = None
        await step()
        assert lab.titles[1:] == ["heliocube roof SIMULATED: answers again"]

    told(scenario)


def test_an_endless_answer_of_a_service_is_reported_like_silence():
    class Endless(httpx.AsyncByteStream):
        async def __aiter__(self):
            while True:
                yield b" "
                await asyncio.sleep(1.0)

    async def scenario():
        transport = httpx.MockTransport(lambda request: httpx.Response(200, stream=Endless()))
        async with httpx.AsyncClient(transport=transport) as client:
            clock, settings = LoopClock(asyncio.get_running_loop().time, NOON_UTC_S), NotifySettings()
            ways = [Way("one")]
            courier = Courier(settings, [parse_address("127.0.0.1:1")], ways, clock, client)
            async with asyncio.timeout(600):
                while not ways[0].told:
                    await asyncio.gather(*await courier.step())
        assert ways[0].told == ["answer"]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_the_longest_poll_interval_stays_below_half_the_watchdog_time_of_the_systemd_unit():
    unit = (Path(__file__).parents[3] / "deploy" / "heliocube-notify.service").read_text()
    watchdog_s = float(re.search(r"^WatchdogSec=(\d+)$", unit, re.MULTILINE)[1])
    assert NotifySettings(poll_every_s=120.0).poll_every_s < watchdog_s / 2
    with pytest.raises(ValidationError):
        NotifySettings(poll_every_s=watchdog_s)


def test_an_alarm_that_ended_while_the_courier_was_not_running_is_sent_as_over_after_the_start(lab, told):
    async def before(step):
        lab.alarms = [lab.alarm(), lab.alarm("clock"), lab.alarm("move-failed")]
        await step()
        await step()

    async def after(step):
        lab.alarms = [lab.alarm("clock"), lab.alarm("move-failed", "cleared")]
        await step()
        await step()

    told(before)
    told(after)
    assert [
        re.split(", |: stow is", line.rpartition("SIMULATED: ")[2])[0] for line in lab.messages[1].splitlines()
    ] == [
        "over: move-failed",
        "over: stow-wanted",
        "WARNING clock",
    ]


def test_a_service_silent_before_a_restart_of_the_courier_is_reported_as_back_when_it_answers(lab, told):
    async def before(step):
        lab.up = False
        for _ in range(15):
            await step()

    async def after(step):
        lab.up = True
        await step()
        await step()

    told(before)
    told(after)
    assert lab.titles[1:] == ["heliocube roof SIMULATED: answers again"]


def test_an_unreadable_record_of_sent_notices_is_logged_and_alarms_are_still_sent(lab, told, tmp_path, caplog):
    (tmp_path / "told.json").write_text("{")

    async def scenario(step):
        lab.alarms = [lab.alarm()]
        await step()

    told(scenario)
    assert [line.partition("told.json ")[2] for line in caplog.messages] == [
        "cannot be read: nobody is told which alarms ended meanwhile"
    ]
    assert len(lab.titles) == 1
