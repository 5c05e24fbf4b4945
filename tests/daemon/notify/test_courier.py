"""Alarms on their way to people, through apprise itself, to a server of the standard library."""

import asyncio
import contextlib
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
from daemon.base.state import StateFolder
from daemon.base.timeloop import virtual_time
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier
from daemon.notify.notification_state import NotificationStateFile
from daemon.notify.recipients import recipients_of

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
    """A service's /api/state, ways to people, and a heartbeat, all on one port; what they receive is kept."""

    def __init__(self):
        self.alarms, self.up, self.taking = [], True, True
        self.told, self.beats = [], 0
        self.instead, self.mode, self.longest = None, "tracking", None
        self.moved_to = None
        lab = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                if self.path == "/beat":
                    lab.beats += 1
                state = {"site": {"name": "roof"}, "simulated": True, "alarms": lab.alarms}
                state["trackers"] = {"tracker": {"mode": {"name": lab.mode}}}
                self.answer(200 if lab.up else 503, lab.instead or json.dumps(state).encode())

            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                taking = lab.taking and (lab.longest is None or len(body) <= lab.longest)
                if taking:
                    lab.told.append((self.path, dict(self.headers), body.decode()))
                self.answer(200 if taking else 500, b"{}")

            def answer(self, status, body):
                moved_to = lab.moved_to if self.command == "POST" else None
                self.send_response(302 if moved_to else status)
                if moved_to:
                    self.send_header("Location", moved_to)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self.server.server_port}"
        # Ending the server takes until its next look.
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True)
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

    @property
    def messages(self):
        return [json.loads(body)["message"] for path, _, body in self.told if path == "/json"]


class Way:
    """A way to a person, which takes a message only while it is free."""

    def __init__(self, name):
        self.name, self.told, self.free = name, [], asyncio.Event()
        self.free.set()

    async def send(self, notice):
        await self.free.wait()
        self.told.append(notice.title.rpartition(" ")[2])
        return True


def test_the_courier_polls_at_its_interval_until_it_is_cancelled():
    looked_s = []

    async def scenario():
        loop = asyncio.get_running_loop()

        def note():
            looked_s.append(loop.time())
            # A courier that does not wait would never let virtual time pass.
            assert len(looked_s) < 10

        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(poll_every_s=10.0), [], [], HandClock(), client, note)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(courier.run(), 35.0)

    with virtual_time() as runner:
        runner.run(scenario())
    assert looked_s == pytest.approx([0.0, 10.0, 20.0, 30.0], abs=0.001)


@pytest.fixture
def lab():
    lab = Lab()
    yield lab
    lab.close()


@pytest.fixture
def told(lab, tmp_path):
    """Run a scenario with a courier of some settings and a clock that a test sets."""

    def run(scenario, *others, **settings):
        people = tmp_path / "people"
        people.write_text("\n".join(["# the lab", "", *(f"json://{lab.address}{path}" for path in ("/json", *others))]))
        people.chmod(0o600)
        chosen = NotifySettings(**settings)

        async def whole():
            clock = HandClock()
            async with httpx.AsyncClient(trust_env=False) as client:
                service = parse_address(lab.address)
                file = NotificationStateFile(StateFolder(tmp_path))
                courier = Courier(chosen, [service], recipients_of(people), clock, client, file=file)

                async def step(after_s=10.0):
                    clock.now += after_s
                    await asyncio.gather(*await courier.step())

                await scenario(step)

        asyncio.run(whole())

    return run


def test_an_alarm_is_sent_once_with_effect_remedy_and_link_and_its_end_is_sent_too(lab, told):
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
            "Effect: the tracker stays in the wind where it stands.",
            "Remedy: make sure that nobody is at the axes, then 'heliocube auto'.",
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


def test_the_end_of_a_latched_alarm_is_sent_once_and_names_the_command_that_acknowledges_it(lab, told):
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


def test_maintenance_does_not_end_an_alarm_and_an_alarm_that_outlasts_it_is_not_sent_again(lab, told):
    async def scenario(step):
        cube = lab.alarm("cube-face") | {"tracker": None}
        lab.alarms = [lab.alarm(), lab.alarm("move-failed"), lab.alarm("reference"), cube]
        await step()
        lab.alarms, lab.mode = [], "maintenance"
        await step()
        await step()
        assert len(lab.titles) == 1
        later = "2026-06-21T13:00:00.000Z"
        other = lab.alarm("move-failed", raised=later) | {"text": "another axis does not move"}
        lab.alarms = [lab.alarm(raised=later), other, cube | {"raised_at": later}]
        lab.mode = "tracking"
        await step()
        await step()
        assert len(lab.titles) == 2
        assert [line.rpartition("SIMULATED: ")[2].partition(",")[0] for line in lab.messages[1].splitlines()] == [
            "CRITICAL move-failed",
            "over: reference",
        ]

    told(scenario)


def test_acknowledged_alarms_and_alarms_that_are_not_severe_enough_are_not_sent(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm(state="acknowledged", by="ana"), lab.alarm("day-budget")]
        await step()
        assert lab.told == []

    told(scenario)


def test_a_notice_that_was_not_delivered_is_sent_again_later_and_never_twice(lab, told):
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


def test_notices_too_long_for_a_recipient_are_sent_in_parts_with_critical_alarms_first(lab, told):
    async def scenario(step):
        rows = [lab.alarm("clock") | {"tracker": f"row-{number}"} for number in range(10)]
        lab.alarms, lab.longest = rows, 600
        await step()
        assert lab.told == []
        lab.alarms = [*rows, lab.alarm()]
        for _ in range(3):
            await step(30.0)
        (first, *rest) = [message.splitlines() for message in lab.messages]
        assert first[0] == "roof SIMULATED: CRITICAL stow-wanted, since 2026-06-21 12:00:00 UTC"
        assert len(first) + sum(map(len, rest)) == 11

    told(scenario)


def test_a_failing_recipient_plugin_is_logged_retried_and_does_not_keep_notices_from_the_others(
    lab, told, monkeypatch, caplog
):
    send = NotifyJSON.send

    def fails_at_first(way, *arguments, **named):
        if way.fullpath == "/json" and not caplog.messages:
            raise RuntimeError("of its own")
        return send(way, *arguments, **named)

    monkeypatch.setattr(NotifyJSON, "send", fails_at_first)

    async def scenario(step):
        lab.alarms = [lab.alarm()]
        await step()
        assert [line for line in caplog.messages if line.startswith("the way to json://")] != []
        assert [path for path, _, _ in lab.told] == ["/other"]
        await step(30.0)
        assert [path for path, _, _ in lab.told] == ["/other", "/json"]

    told(scenario, "/other")


def test_a_recipient_whose_own_code_raises_is_logged_once_as_down_then_back_and_costs_no_other(lab, caplog):
    caplog.set_level("INFO")

    class Raising(Way):
        async def send(self, notice):
            assert self.free.is_set(), "of its own"
            return await super().send(notice)

    async def scenario():
        way, other, clock = Raising("roof"), Way("other"), HandClock()
        way.free.clear()
        lab.alarms = [lab.alarm()]
        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(), [parse_address(lab.address)], [way, other], clock, client)
            for _ in range(4):
                await asyncio.wait(await courier.step())
            assert other.told == ["stow-wanted"]
            way.free.set()
            await asyncio.gather(*await courier.step())
        down, back = (line for line in caplog.messages if line.startswith("the way to roof"))
        assert down.startswith("the way to roof is down: it cannot be used: AssertionError(")
        assert (back, way.told) == ("the way to roof is back", ["stow-wanted"])

    asyncio.run(scenario())


def test_a_slow_recipient_delays_neither_the_next_round_nor_the_other_recipients(lab):
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


def test_the_heartbeat_is_sent_at_its_interval_while_the_courier_works(lab, told):
    async def scenario(step):
        for _ in range(7):
            await step()
        assert lab.beats == 3

    told(scenario, heartbeat=f"http://{lab.address}/beat", heartbeat_every_s=30.0)


def test_a_heartbeat_that_cannot_even_be_tried_is_logged_once_until_it_works(lab, told, monkeypatch, caplog):
    monkeypatch.setenv("HTTP_PROXY", "foo://proxy:1")

    async def scenario(step):
        for _ in range(5):
            await step(30.0)
        (line,) = caplog.messages
        assert line.startswith("the heartbeat is down: it cannot be asked: ValueError(")
        monkeypatch.delenv("HTTP_PROXY")
        await step(30.0)
        assert lab.beats == 1

    told(scenario, heartbeat=f"http://{lab.address}/beat", heartbeat_every_s=30.0)
