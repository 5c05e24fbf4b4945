"""Alarms on their way to people, by apprise's own ways, to a server of the standard library."""

import asyncio
import json
import threading
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest
from apprise.plugins.custom_json import NotifyJSON

from daemon.api.models import AlarmPart
from daemon.base.addresses import parse_address
from daemon.base.alarms.kinds import KINDS
from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier
from daemon.notify.courier import test as try_out
from daemon.notify.recipients import recipients_of
from tests.support import forks

pytestmark = pytest.mark.slow

NOON_UTC_S = datetime(2026, 6, 21, 12, 0).astimezone(UTC).timestamp()
WIND = "stow is wanted (wind 20.0 m/s)"


class HandClock:
    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now

    def utc(self):
        return NOON_UTC_S + self.now - 1000.0


class Lab:
    """A service's /api/state, ways to people, and a heartbeat, all on one port; what they get is kept."""

    def __init__(self):
        self.alarms, self.up, self.taking = [], True, True
        self.told, self.beats = [], 0
        self.instead = None
        lab = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                if self.path == "/beat":
                    lab.beats += 1
                state = {"site": {"name": "roof"}, "simulated": True, "alarms": lab.alarms}
                self.answer(200 if lab.up else 503, lab.instead or json.dumps(state).encode())

            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if lab.taking:
                    lab.told.append((self.path, dict(self.headers), body.decode()))
                self.answer(200 if lab.taking else 500, b"{}")

            def answer(self, status, body):
                self.send_response(status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self.server.server_port}"
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
        self.thread.start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()

    def alarm(self, name="stow-wanted", state="raised", raised="2026-06-21T12:00:00.000Z", by=None):
        kind = KINDS[name]
        found = {
            "name": name,
            "severity": kind.severity.value,
            "state": state,
            "text": WIND,
            "cause": kind.cause,
            "effect": kind.effect,
            "remedy": kind.remedy,
            "latched": kind.latched,
            "since": raised,
            "raised_at": raised,
            "acknowledged_at": raised if state == "acknowledged" else None,
            "acknowledged_by": by,
            "cleared_at": raised if state == "cleared" else None,
            "tracker": "tracker",
        }
        AlarmPart.model_validate(found)
        return found

    @property
    def titles(self):
        return [json.loads(body)["title"] for path, _, body in self.told if path == "/json"]


class Way:
    """A way to somebody, which takes what it is given once it is free."""

    def __init__(self, name):
        self.name, self.told, self.free = name, [], asyncio.Event()
        self.free.set()

    async def tell(self, notice):
        await self.free.wait()
        self.told.append(notice.title.rpartition(" ")[2])
        return True


@pytest.fixture
def lab():
    lab = Lab()
    yield lab
    lab.close()


@pytest.fixture
def told(lab, tmp_path):
    """Run a scenario with a courier of some settings and a clock set by hand."""

    def run(scenario, **settings):
        people = tmp_path / "people"
        people.write_text(f"# the lab\n\njson://{lab.address}/json\n")
        people.chmod(0o600)
        chosen = NotifySettings(**settings)

        async def whole():
            clock = HandClock()
            async with httpx.AsyncClient(trust_env=False) as client:
                service = parse_address(lab.address)
                courier = Courier(chosen, [service], recipients_of(people), clock, client)

                async def step(after_s=10.0):
                    clock.now += after_s
                    await asyncio.gather(*await courier.step())

                await scenario(step)

        asyncio.run(whole())

    return run


def test_an_alarm_is_told_once_with_effect_remedy_and_link_and_its_end_too(lab, told):
    async def scenario(step):
        await step()
        assert lab.told == []
        lab.alarms = [lab.alarm()]
        await step()
        await step()
        ((_, _, body),) = lab.told
        found = json.loads(body)
        assert found["title"] == "heliocube roof SIMULATED: CRITICAL stow-wanted"
        assert found["type"] == "failure"
        assert found["message"].splitlines() == [
            f"{WIND}.",
            "Effect: the module stands in the wind as it was left.",
            "Remedy: see that nobody is at the axes, then 'heliocube auto'.",
            "Since 2026-06-21 12:00:00 UTC.",
            "https://tracker.lab/",
        ]
        lab.alarms = [lab.alarm(state="acknowledged", by="ana")]
        await step()
        lab.alarms = []
        await step()
        assert lab.titles[1:] == ["heliocube roof SIMULATED: over: stow-wanted"]
        lab.alarms = [lab.alarm(raised="2026-06-21T13:00:00.000Z")]
        await step()
        assert len(lab.titles) == 3

    told(scenario, dashboard="https://tracker.lab/")


def test_a_latched_one_is_over_once_and_says_that_somebody_has_to_look(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm("move-failed")]
        await step()
        lab.alarms = [lab.alarm("move-failed", "cleared")]
        await step()
        await step()
        lab.alarms = []
        await step()
        assert [title.rpartition(": ")[2] for title in lab.titles] == ["CRITICAL move-failed", "move-failed"]
        assert "'heliocube alarms ack move-failed'" in lab.told[1][2]

    told(scenario)


def test_what_somebody_has_seen_already_and_what_is_not_severe_enough_is_not_told(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm(state="acknowledged", by="ana"), lab.alarm("day-budget")]
        await step()
        assert lab.told == []

    told(scenario)


def test_in_quiet_hours_only_critical_ones_are_told_the_others_together_afterwards(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm("clock")]
        await step()
        lab.alarms = [lab.alarm("clock"), lab.alarm("cube-face"), lab.alarm()]
        await step()
        assert [title.rpartition(" ")[2] for title in lab.titles] == ["stow-wanted"]
        await step(3600.0)
        ((_, _, body),) = lab.told[1:]
        found = json.loads(body)
        assert found["title"] == "heliocube: 2 changes of alarms"
        assert found["message"].splitlines() == ["roof SIMULATED: WARNING clock", "roof SIMULATED: WARNING cube-face"]

    told(scenario, quiet_from="11:30", quiet_until="12:30")


def test_what_comes_and_goes_is_gathered_into_one_message(lab, told):
    async def scenario(step):
        for number in range(12):
            lab.alarms = [lab.alarm(raised=f"2026-06-21T12:00:{number:02}.000Z")] if number % 2 == 0 else []
            await step(1.0)
        assert len(lab.titles) == 3
        await step(1200.0)
        assert lab.titles[3:] == ["heliocube: 9 changes of alarms"]

    told(scenario, most_per_hour=3)


def test_what_is_not_taken_is_tried_again_and_nothing_is_told_twice(lab, told):
    async def scenario(step):
        lab.alarms, lab.taking = [lab.alarm()], False
        await step()
        lab.taking = True
        await step(10.0)
        assert lab.told == []
        await step(30.0)
        await step(30.0)
        assert len(lab.titles) == 1

    told(scenario)


def test_a_way_that_fails_as_nobody_expected_is_logged_and_costs_no_other(lab, told, monkeypatch, caplog):
    send = NotifyJSON.send

    def fails_at_first(way, *arguments, **named):
        if not caplog.messages:
            raise RuntimeError("of its own")
        return send(way, *arguments, **named)

    monkeypatch.setattr(NotifyJSON, "send", fails_at_first)

    async def scenario(step):
        lab.alarms = [lab.alarm()]
        await step()
        assert [line for line in caplog.messages if line.startswith("the way to json://")] != []
        await step(30.0)
        assert len(lab.titles) == 1

    told(scenario)


def test_a_service_that_is_silent_is_told_once_and_its_return_too(lab, told):
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


ROOF = '{"site": {"name": "roof"}, "simulated": true'


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
def test_what_answers_in_the_place_of_the_service_is_told_like_silence(lab, told, page):
    async def scenario(step):
        lab.instead = page.encode()
        for _ in range(15):
            await step()
        assert "for 120 s: what answers there is not heliocube." in json.loads(lab.told[0][2])["message"]
        lab.instead = None
        await step()
        assert lab.titles[1:] == ["heliocube roof SIMULATED: answers again"]

    told(scenario)


def test_an_answer_without_an_end_is_told_like_silence():
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


def test_a_way_that_takes_its_time_keeps_neither_the_next_round_nor_the_others_waiting(lab):
    async def scenario():
        slow, quick = Way("slow"), Way("quick")
        slow.free.clear()
        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(), [parse_address(lab.address)], [slow, quick], HandClock(), client)
            for name in ("stow-wanted", "clock"):
                lab.alarms.append(lab.alarm(name))
                under_way = await asyncio.wait_for(courier.step(), 60)
            slow.free.set()
            await asyncio.gather(*under_way)
            assert (slow.told, quick.told) == (["stow-wanted"], ["stow-wanted", "clock"])
            await asyncio.gather(*await courier.step())
            assert slow.told == ["stow-wanted", "clock"]

    asyncio.run(scenario())


def test_the_heart_beats_while_it_works(lab, told):
    async def scenario(step):
        for _ in range(7):
            await step()
        assert lab.beats == 3

    told(scenario, heartbeat=f"http://{lab.address}/beat", heartbeat_every_s=30.0)


def test_a_try_says_of_each_way_and_of_the_heartbeat_what_came_of_it(lab, tmp_path):
    people = tmp_path / "people"
    people.write_text(f"ntfy://{lab.address}/roof\njson://user:secret@127.0.0.1:1/\n")
    people.chmod(0o640)
    lines = []
    settings = NotifySettings(heartbeat=f"http://{lab.address}/beat")
    assert asyncio.run(try_out(settings, recipients_of(people), lines.append)) is False
    assert [line.rpartition(": ")[2] for line in lines] == ["taken", "not taken; see the lines above", "taken"]
    assert "secret" not in "".join(lines)
    assert "a test" in str(lab.told[0])


def test_a_try_that_does_not_reach_everybody_ends_with_4(lab, tmp_path):
    config, people = tmp_path / "notify.toml", tmp_path / "people"
    config.write_text("[notify]\npeople_file = 'people'\n")
    people.touch(0o600)
    for port, code in ((lab.address.rpartition(":")[2], 0), ("1", 4)):
        people.write_text(f"json://127.0.0.1:{port}/\n")
        done = forks.run("notify", "--config", config, "--test")
        assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr


@pytest.mark.parametrize(
    ("content", "mode", "sentence"),
    [
        (None, 0o600, "does not exist: write one apprise address on each line, such as ntfy://ntfy.lab/roof, and run"),
        ("", 0o600, "names nobody"),
        ("tea://secret\n", 0o600, "line 1: no address that apprise knows"),
        ("# x\njson://\n", 0o600, "line 2: no address that apprise knows"),
        ("json://a/\n", 0o644, "is open to others than its owner and its group's readers: run chmod 640"),
    ],
)
def test_a_file_that_names_nobody_is_refused_without_what_is_secret(tmp_path, content, mode, sentence):
    people = tmp_path / "people"
    if content is not None:
        people.write_text(content)
        people.chmod(mode)
    with pytest.raises(UserError) as refused:
        recipients_of(people)
    assert sentence in str(refused.value)
    assert "secret" not in str(refused.value)
