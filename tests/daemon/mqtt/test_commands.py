"""A command is carried out once, when it is given, and a flood of commands slows neither log nor telemetry."""

import asyncio
import json
import time
from datetime import UTC, datetime

import pytest

from daemon.base.records import Mode
from daemon.config.links import MqttSettings
from daemon.mqtt.commands import Commands
from daemon.mqtt.connection import Incoming
from daemon.mqtt.outbox import Lane, Message, Outbox
from daemon.mqtt.replay_guard import ReplayGuard
from daemon.service.operator import CommandError
from daemon.service.operator_commands import Operators, parse
from tests.support.mqtt import SPEED, BrokerRig, needs_mosquitto, observer, run_services, settings_for, until
from tests.support.phases import wait_for_tracking

BASE = "heliocube/tracker"
UTC_S = 1665742815.0


def broker_rig(port, **mqtt):
    return BrokerRig(asyncio.get_running_loop(), settings_for(port, mqtt=mqtt), SPEED)


def test_an_empty_message_as_sent_to_clear_a_retained_command_is_refused_and_changes_nothing(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port)
            async with run_services(rig):
                await rig.until_mode(Mode.TRACKING, 400)
                await lab.publish(f"{BASE}/command/stop", {"why": "a person"})
                await lab.until(f"{BASE}/reply", lambda reply: reply["accepted"])
                for payload, retain in ((b"", True), (b"", False), (b" \n", False)):
                    count = len(lab.messages_on(f"{BASE}/reply"))
                    await lab.publish(f"{BASE}/command/auto", payload, retain=retain)
                    reply = await lab.until(f"{BASE}/reply", after=count)
                    assert reply["accepted"] is False
                    assert "no command" in reply["text"] or "retained" in reply["text"]
                assert rig.control.wishes.stop is not None
                await lab.publish(f"{BASE}/command/auto", {})
                await lab.until(f"{BASE}/reply", lambda reply: reply["accepted"] and reply["command"] == "auto")
                assert rig.control.wishes.stop is None

    run_scaled(scenario)


@needs_mosquitto
def test_a_command_that_is_published_retained_while_the_service_is_connected_does_nothing(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port)
            async with run_services(rig):
                await rig.until_mode(Mode.TRACKING, 400)
                for name in ("stow", "stop", "goto"):
                    count = len(lab.messages_on(f"{BASE}/reply"))
                    await lab.publish(f"{BASE}/command/{name}", {"why": "to stay"}, retain=True)
                    reply = await lab.until(f"{BASE}/reply", after=count)
                    assert (reply["command"], reply["accepted"]) == (name, False)
                    assert "retained" in reply["text"]
                assert rig.mode is Mode.TRACKING

    run_scaled(scenario)


def test_a_flood_of_commands_is_answered_and_logged_within_bounds_and_a_stop_among_them_is_carried_out(
    broker, run_scaled, log_lines
):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port, dated_commands=False)
            async with run_services(rig):
                await rig.until_mode(Mode.TRACKING, 400)
                began_s = time.monotonic()
                for number in range(400):
                    name = ("auto", "maintenance", "nonsense", "hold")[number % 4]
                    payload = {"mode": "none"} if name == "nonsense" else {"why": f"flood {number}"}
                    topic = f"{BASE}/command/{'mode' if name == 'nonsense' else name}"
                    await lab.client.publish(topic, json.dumps(payload), qos=0)
                await lab.publish(f"{BASE}/command/stop", {"why": "a person", "id": "mine"})
                await until(lambda: rig.control.wishes.stop is not None, "the stop")
                assert rig.control.wishes.stop.why == "a person"
                own = await lab.until(f"{BASE}/reply", lambda reply: reply["id"] == "mine")
                assert own["accepted"], own
                await until(lambda: not rig.mqtt._commands._running, "the end of the commands")
                await until(lambda: rig.mqtt.status.waiting == 0, "all replies")
            replies = lab.messages_on(f"{BASE}/reply")
            # Of each of the two kinds 50 are answered at once, and then ten a second: a slow machine hears more.
            assert 20 <= len(replies) <= 110 + 22 * (time.monotonic() - began_s)
            refused = [line for line in log_lines() if "over MQTT" in line.getMessage()]
            assert 1 <= len(refused) <= 8
            assert any("only their number is logged" in line.getMessage() for line in refused)

    run_scaled(scenario)


def test_queued_replies_do_not_push_out_telemetry_and_keep_their_place_among_it():
    async def scenario():
        outbox = Outbox(10)
        for number in range(10):
            outbox.put(Message("pose", b"%d" % number))
            outbox.put(Message("reply", b"%d" % number), Lane.ANSWERS)
        outbox.put(Message("state", b""), Lane.URGENT)
        came = [await outbox.take() for _ in range(outbox.waiting)]
        assert came[0].topic == "state"
        assert [(one.topic, int(one.payload)) for one in came[1:]] == [
            (topic, number) for number in range(10) for topic in ("pose", "reply")
        ]
        outbox.put(Message("pose", b"0"))
        for number in range(1000):
            outbox.put(Message("reply", b"%d" % number), Lane.ANSWERS)
        assert outbox.waiting == 1 + 256
        first = await outbox.take()
        assert first.topic == "pose"
        outbox.put(Message("pose", b"1"))
        outbox.put_back(first)
        assert [await outbox.take() for _ in range(2)] == [first, Message("reply", b"744")]

    asyncio.run(scenario())


class Watch:
    """A clock that a test sets."""

    now_s = 1000.0
    ahead_s = 0.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return UTC_S + self.now_s + self.ahead_s


class Given:
    """Dates on a clock that a test sets, and the verdict on one command."""

    def __init__(self, **settings):
        self.clock = Watch()
        self.dates = ReplayGuard(MqttSettings(**settings), self.clock)

    def refusal(self, name="stow", off_s=0.0, dated=True, identifier="1"):
        body = {} if identifier is None else {"id": identifier}
        if dated:
            body["time"] = datetime.fromtimestamp(self.clock.utc() + off_s, UTC).isoformat()
        try:
            self.dates.check(parse(name, json.dumps(body).encode(), "MQTT"))
        except CommandError as error:
            return str(error)
        return None


def test_a_dated_command_is_accepted_only_once_and_only_within_30_s_of_its_time():
    given = Given()
    given.clock.now_s += 100.0
    assert given.refusal(off_s=-29.0) is None
    assert "has been given before" in given.refusal(off_s=-29.0)
    assert given.refusal(off_s=-29.0, identifier="2") is None
    assert "31 s behind this machine's clock, more than mqtt.command_age_s = 30 s" in given.refusal(off_s=-31.0)
    assert "ahead of" in given.refusal(off_s=31.0)
    assert given.refusal(dated=False, identifier=None) is None
    given.clock.now_s += 60.0
    assert "behind" in given.refusal(off_s=-89.0), "what is forgotten is too old by then"


def test_different_commands_with_the_same_time_and_no_id_are_not_taken_for_repeats():
    given = Given()
    given.clock.now_s += 100.0
    for name in ("hold", "stow", "maintenance"):
        assert given.refusal(name, identifier=None) is None
    assert "has been given before" in given.refusal("stow", identifier=None)


def test_when_dates_are_required_a_command_without_id_or_time_is_refused_but_a_stop_never_is():
    given = Given(dated_commands=True)
    given.clock.now_s += 100.0
    for dated, identifier in ((False, None), (True, None), (False, "1")):
        assert 'a command needs an "id" and a "time" of its own' in given.refusal(dated=dated, identifier=identifier)
        assert given.refusal("stop", dated=dated, identifier=identifier) is None
    assert given.refusal("stop", off_s=-1e6) is None
    assert given.refusal() is None


def test_a_command_dated_before_the_service_began_to_listen_is_refused():
    given = Given()
    given.clock.now_s += 5.0
    assert "before this service began to listen" in given.refusal(off_s=-6.0)
    assert given.refusal(off_s=-4.0) is None


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_after_the_clock_is_set_new_commands_are_accepted_and_those_before_the_start_stay_refused(step_s):
    given = Given()
    given.clock.now_s += 10.0
    given.clock.ahead_s += step_s
    assert given.refusal() is None
    assert "before this service began to listen" in given.refusal(off_s=-11.0)


def test_a_repeated_command_that_looks_new_after_the_clock_was_set_back_is_refused():
    given = Given(dated_commands=True)
    given.clock.now_s += 2000.0
    assert given.refusal() is None
    given.clock.now_s += 1000.0
    assert given.refusal() is None
    given.clock.ahead_s -= 1000.0
    assert "has been given before" in given.refusal()


def test_in_a_flood_of_dated_commands_4096_are_accepted_and_others_refused_until_these_expire():
    given = Given(command_age_s=60.0)
    answers = [given.refusal(identifier=str(number)) for number in range(4200)]
    assert answers.count(None) == 4096
    assert "ask again later" in answers[-1]
    given.clock.now_s += 121.0
    assert given.refusal(identifier="again") is None


def test_a_flood_of_dated_auto_commands_leaves_room_for_stow_maintenance_and_stop():
    given = Given(dated_commands=True)
    given.clock.now_s += 100.0
    assert "ask again later" in [given.refusal("auto", identifier=str(number)) for number in range(4100)][-1]
    assert [given.refusal(name, identifier=name) for name in ("stow", "maintenance", "stop")] == [None] * 3
    assert "has been given before" in given.refusal("stow", identifier="7"), "a date is of one command alone"


def test_a_dated_command_refused_while_others_are_carried_out_may_be_sent_again_with_the_same_date():
    class Slow:
        """Carries a command out only when it is set free."""

        def __init__(self):
            self.free = asyncio.Event()

        async def carry_out(self, command):
            await self.free.wait()
            return {"id": command.identifier, "text": "done"}

    async def scenario():
        slow, clock, replies = Slow(), Watch(), []
        clock.now_s += 100.0
        commands = Commands(slow, replies.append, MqttSettings(dated_commands=True), clock)

        def give(identifier):
            body = {"id": identifier, "time": datetime.fromtimestamp(clock.utc(), UTC).isoformat()}
            commands.take("auto", Incoming("auto", json.dumps(body).encode(), retained=False))

        async def others():
            await asyncio.gather(*asyncio.all_tasks() - {asyncio.current_task()})

        for number in range(9):
            give(f"{number}")
        ((refused, text),) = [(reply["id"], reply["text"]) for reply in replies]
        assert (refused, "ask again" in text) == ("8", True)
        slow.free.set()
        await others()
        give("8")
        await others()
        assert replies[-1] == {"id": "8", "text": "done"}

    asyncio.run(scenario())


@pytest.mark.parametrize("time", ["yesterday", "2022-10-14T10:20:00", "9" * 100, "0001-01-01T00:00:00"])
def test_a_command_time_that_is_not_iso_8601_with_a_zone_is_refused_in_one_sentence(time):
    with pytest.raises(CommandError, match="ISO 8601 with its zone"):
        parse("stow", json.dumps({"time": time}).encode(), "MQTT")


def test_a_command_over_http_with_a_time_is_refused():
    with pytest.raises(CommandError, match="may have only"):
        parse("stow", b'{"time": "2022-10-14T10:20:00Z"}', "HTTP")


def test_a_stop_is_carried_out_however_many_commands_wait_for_their_replies(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        replies = []
        commands = Commands(Operators([rig.tracker], 1.0), replies.append, MqttSettings(), rig.clock)

        def give(name, identifier, tracker=None):
            body = {"id": identifier, "why": identifier} | ({"tracker": tracker} if tracker else {})
            commands.take(name, Incoming(name, json.dumps(body).encode(), retained=False))

        for number in range(64):
            give("stop", f"first {number}")
        give("stop", "of another", "elsewhere")
        give("auto", "all clear")
        give("stop", "a hand")
        begun_s = time.process_time()
        for number in range(12_000):
            give("stop", f"last {number}")
        assert time.process_time() - begun_s < 5.0, "each costs the same, however many there are"
        await asyncio.sleep(0.0)
        assert rig.control.wishes.stop.why == "a hand"
        assert len(commands._running) > 1000
        await asyncio.sleep(0.0)
        assert len(commands._running) < 70, "those that change nothing wait for nothing"
        await asyncio.gather(*commands._running)
        refused = {reply["id"]: reply["text"] for reply in replies if not reply["accepted"]}
        assert list(refused) == ["of another"], "a stop is refused for want of nothing but its tracker"
        assert any("wait for their answers" in reply["text"] for reply in replies)

    run_rig(scenario)
