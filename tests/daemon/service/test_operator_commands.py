"""One parser for commands, whatever way they come."""

import asyncio
import json
import logging
import math
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from daemon.api.client import Client, NoServiceError
from daemon.base.addresses import parse_address
from daemon.base.records import Event
from daemon.service.command_bodies import MODES
from daemon.service.operator import CommandError, Effect, Operator
from daemon.service.operator_commands import COMMAND_NAMES, URGENT, BodyError, Operators, TooManyError, parse
from daemon.service.recent import RecentRecords
from daemon.service.state import state_json
from tests.support import PATIENCE_S, ROOT
from tests.support.motion import commands_sent
from tests.support.phases import wait_for_move, wait_for_tracking


def test_every_command_has_its_operator_method_and_every_mode_is_a_command():
    assert all(callable(getattr(Operator, name)) for name in COMMAND_NAMES if name not in ("mode", "acknowledge"))
    assert set(MODES) | set(URGENT) < set(COMMAND_NAMES)


@pytest.mark.parametrize("name", [name for name in COMMAND_NAMES if name not in ("goto", "mode")])
def test_a_command_with_an_empty_body_is_attributed_to_the_way_by_which_it_came(name):
    command = parse(name, b"", "MQTT")
    assert (command.name, command.action, command.by, command.why) == (name, name, "MQTT", "an operator asked")
    assert command.identifier is None


def test_reason_person_and_identifier_in_the_body_of_a_command_are_kept():
    command = parse("goto", b'{"a_deg": -10, "b_deg": 60, "why": "test", "by": "ana@lab", "id": "7"}', "HTTP")
    assert (command.why, command.by, command.identifier) == ("test", "ana@lab", "7")
    assert (command.a_deg, command.b_deg) == (-10.0, 60.0)


@pytest.mark.parametrize("content", [b"snow", b'{"mode": "snow"}'])
def test_the_mode_command_accepts_a_plain_word_or_a_json_object(content):
    assert parse("mode", content, "MQTT").action == "snow"


def test_a_goto_angle_beyond_every_float_becomes_infinity_for_the_limits_to_refuse():
    assert parse("goto", b'{"a_deg": 1' + b"0" * 400 + b', "b_deg": 60}', "HTTP").a_deg == math.inf


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("stow", b"halt!", "the body is not JSON"),
        ("stow", b"\xff\xfe", "the body is not JSON"),
        ("stow", b"[" * 4000, "the body is not JSON"),
        ("stow", b"[1]", 'the body is not a JSON object, such as {"why": "maintenance"}'),
        ("stow", b"x" * 4097, "the body is longer than 4096 bytes"),
        ("stow", b'{"when": 1}', "the body has 'when', but may have only why, by, id, tracker"),
        ("stow", b'{"why": "a", "why": "b"}', "the body has 'why' twice"),
        ("goto", b'{"a_deg": 1, "b_deg": 2, "a_deg": 3}', "the body has 'a_deg' twice"),
        ("stow", b'{"why": {"x": 1, "x": 2}}', "the body has 'x' twice"),
        ("stow", b'{"\\ud800": 1}', r"the body has '\\ud800', but may have only why, by, id, tracker"),
        ("goto", b'{"c_deg": 1}', "the body has 'c_deg', but may have only a_deg, b_deg, why, by, id, tracker"),
        ("stow", b'{"id": null}', '"id" must be one line of text with at most 200 letters'),
        (
            "goto",
            b'{"a_deg": true, "b_deg": 60}',
            'goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}',
        ),
        ("goto", b"", 'goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}'),
        ("mode", b"", "the mode must be one of auto, hold, stow, snow, maintenance"),
        ("mode", b'{"mode": ["stow"]}', "the mode must be one of auto, hold, stow, snow, maintenance"),
        ("mode", b"Stow", "the mode must be one of auto, hold, stow, snow, maintenance"),
        ("mode", b'"auto"', "the mode must be one of auto, hold, stow, snow, maintenance"),
        (
            "mode",
            b"stop",
            "the mode must be one of auto, hold, stow, snow, maintenance; for a stop, use the command stop",
        ),
        ("mode", b'{"mode": "hold"', "the body is not JSON"),
    ],
)
def test_a_malformed_command_body_is_refused_in_one_sentence(name, content, sentence):
    with pytest.raises(BodyError) as refused:
        parse(name, content, "HTTP")
    assert str(refused.value) == sentence
    assert refused.value.wrong


@pytest.mark.parametrize("way", ["HTTP", "MQTT"])
@pytest.mark.parametrize(
    ("content", "kept"),
    [
        (b"halt!", {}),
        (b"\xff\xfe", {}),
        (b"[" * 4000, {}),
        (b"[1]", {}),
        (b'{"why": "%s"}' % (b"x" * 4097), {}),
        (b'{"why": "a", "why": "b"}', {}),
        (b'{"when": 1, "why": "gust"}', {"why": "gust"}),
        (b'{"id": null, "by": "ana@lab"}', {"by": "ana@lab"}),
        (b'{"tracker": ["east"], "id": "7"}', {"identifier": "7"}),
        (b'{"time": "yesterday", "tracker": "east"}', {"tracker": "east"}),
        (b'{"\\ud800": 1, "why": "gust"}', {"why": "gust"}),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_a_stop_with_a_malformed_body_is_accepted_and_its_readable_parts_are_kept(way, content, kept):
    command = parse("stop", content, way)
    assert command.action == "stop"
    assert {name: getattr(command, name) for name in ("why", "by", "identifier", "tracker")} == {
        "why": "an operator asked",
        "by": way,
        "identifier": None,
        "tracker": None,
    } | kept


@pytest.mark.parametrize("name", ["stop", "stow", "maintenance", "hold"])
@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("x" * 201, "x" * 200),
        ("gust\nall\tdown\x00 ", "gust all down"),
        ("B\udcc3\udcb6e", "B e"),
        ("  ", None),
        ("", None),
        (None, None),
        (["gust"], None),
    ],
)
def test_no_command_is_refused_for_the_text_of_its_reason_or_person(name, said, kept):
    command = parse(name, json.dumps({"why": said, "by": said}).encode(), "HTTP")
    assert (command.why, command.by) == (kept or "an operator asked", kept or "HTTP")


@pytest.mark.parametrize(
    ("typed", "kept"), [("x" * 5000, "x" * 200), ("B\udcc3\udcb6e", "Böe"), ("\ud800", "?"), ("🌪" * 300, "🌪" * 200)]
)
def test_a_reason_of_any_length_and_encoding_gets_to_the_service(monkeypatch, typed, kept):
    monkeypatch.setenv("LOGNAME", "🌪" * 100)
    listener, heard = answering(b'HTTP/1.1 200 x\r\n\r\n{"state": "done", "text": "standing"}')
    with listener:
        client = Client(parse_address(f"127.0.0.1:{listener.getsockname()[1]}"), "t" * 43)
        assert client.command("stop", why=typed).text == "standing"
    assert len(json.dumps(heard[0], ensure_ascii=False).encode()) <= 4096
    assert parse("stop", json.dumps(heard[0]).encode(), "HTTP").why == kept


def answering(reply):
    """Listen on loopback and answer one request with `reply`; return the port and what was heard."""
    listener = socket.create_server(("127.0.0.1", 0))
    heard = []

    def serve():
        connection, _ = listener.accept()
        with connection:
            content = b""
            while b"\r\n\r\n" not in content or (content.startswith(b"POST") and b"}" not in content):
                content += connection.recv(65536)
            heard.append(json.loads(content.partition(b"\r\n\r\n")[2] or b"{}"))
            connection.sendall(reply)

    threading.Thread(target=serve, daemon=True).start()
    return listener, heard


@pytest.mark.parametrize(
    "command", [["stop"], ["stop", "--why", "a hand"], ["stop", "--tracker", "west"], ["goto", "10", "60"]]
)
@pytest.mark.parametrize(
    ("status", "body", "code", "out", "err"),
    [
        (200, {"state": "done", "text": "standing"}, 0, "standing\n", ""),
        (200, {"state": "under-way", "text": "moving"}, 0, "moving\n", ""),
        (200, {"state": "not-seen", "text": "moving on"}, 3, "moving on\n", ""),
        (409, {"error": "no goto: stopped"}, 6, "", "heliocube: no goto: stopped\n"),
    ],
)
def test_the_command_line_prints_the_answer_and_ends_with_the_exit_code_of_what_was_seen(
    tmp_path, command, status, body, code, out, err
):
    listener, heard = answering(f"HTTP/1.1 {status} x\r\n\r\n{json.dumps(body)}".encode())
    with listener:
        done = _program(tmp_path, listener, *command, LOGNAME="ana")
    assert (done.returncode, done.stdout, done.stderr) == (code, out, err)
    assert heard[0]["by"] == f"ana@{socket.gethostname()}"
    assert heard[0].get("tracker") == ("west" if "west" in command else None)


@pytest.mark.parametrize("command", [["stow"], ["hold"], ["goto", "10", "60"]])
@pytest.mark.parametrize("trackers", [["--tracker", "west", "--tracker", "east"], ["--tracker=west", "--tracker=east"]])
def test_a_command_line_that_names_two_trackers_is_refused(tmp_path, command, trackers):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        done = _program(tmp_path, listener, *command, *trackers)
    assert (done.returncode, done.stdout) == (2, "")
    assert "--tracker is given more than once" in done.stderr


@pytest.mark.parametrize("command", ["stop", "status"])
def test_an_answer_is_printed_on_a_terminal_that_knows_only_ascii(tmp_path, run_rig, command):
    page = {}

    async def scenario(rig):
        await wait_for_tracking(rig)
        await Operator(rig.tracker, 1.0).stop("Böe")
        page.update(state_json(rig.take_snapshot(RecentRecords())))

    run_rig(scenario)
    page |= {"state": "done", "text": "standing; mode hold: Böe"}
    listener, _ = answering(f"HTTP/1.1 200 x\r\n\r\n{json.dumps(page)}".encode())
    with listener:
        done = _program(tmp_path, listener, command, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "B?e" in done.stdout


@pytest.mark.parametrize("command", [["stop"], ["goto", "3", "80"]])
def test_ctrl_c_while_a_service_hangs_says_that_the_command_may_have_been_taken(tmp_path, command):
    with socket.create_server(("127.0.0.1", 0)) as hanging:
        config = _config(tmp_path, hanging.getsockname()[1])
        process = subprocess.Popen(
            [sys.executable, "-c", "from daemon.entry import main; main()", *command, "--config", config],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={"HELIOCUBE_TOKEN": "t" * 43, "PATH": "", "LOGNAME": "ana"},
        )
        with process:
            hanging.settimeout(PATIENCE_S)
            connection, _ = hanging.accept()
            with connection:
                assert connection.recv(1)
                process.send_signal(signal.SIGINT)
                out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert (out, err) == ("", "heliocube: interrupted: the command may have been taken; see 'heliocube status'\n")


def test_a_stop_whose_answer_was_cut_off_is_sent_again_and_a_goto_is_not():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        heard = []

        def serve():
            cut = b"HTTP/1.1 200 OK\r\nContent-Length: 300\r\n\r\n{"
            for reply in (b"", cut, b'HTTP/1.1 200 x\r\n\r\n{"state": "done", "text": "standing"}', cut):
                connection, _ = listener.accept()
                with connection:
                    heard.append(connection.recv(65536).split()[1].decode())
                    connection.sendall(reply)

        serving = threading.Thread(target=serve, daemon=True)
        serving.start()
        client = Client(parse_address(f"127.0.0.1:{listener.getsockname()[1]}"), "t" * 43)
        assert client.command("stop").text == "standing"
        with pytest.raises(NoServiceError) as error:
            client.command("goto", a_deg=1.0, b_deg=60.0)
        assert str(error.value) == (
            f"the service at {client.address} does not answer: the connection was cut off before the end of the answer;"
            " it may have taken the command all the same: see 'heliocube status'"
        )
        serving.join(PATIENCE_S)
    assert heard == ["/api/stop"] * 3 + ["/api/goto"]


def test_a_stop_is_given_even_when_its_answer_cannot_be_written_to_standard_output(tmp_path):
    listener, heard = answering(b'HTTP/1.1 200 x\r\n\r\n{"state": "done", "text": "standing"}')
    with listener, Path("/dev/full").open("w") as full:
        done = _program(tmp_path, listener, "stop", stdout=full)
    assert (len(heard), done.returncode) == (1, 7)
    assert done.stderr == "heliocube: the answer cannot be written to standard output: No space left on device\n"


def _program(tmp_path, listener, *command, stdout=subprocess.PIPE, **environment):
    """Give a command to the listener, and return how the program ended."""
    config = _config(tmp_path, listener.getsockname()[1])
    return subprocess.run(
        [sys.executable, "-c", "from daemon.entry import main; main()", *command],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={"HELIOCUBE_CONFIG": str(config), "HELIOCUBE_TOKEN": "t" * 43, "PATH": ""} | environment,
        timeout=PATIENCE_S,
    )


def _config(folder, port):
    path = folder / "heliocube.toml"
    path.write_text(f"[api]\nlisten = '127.0.0.1:{port}'\n")
    return path


def test_too_many_commands_a_second_are_refused_for_each_way_on_its_own_and_a_stop_never_is(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        operators = Operators(rig.service.trackers, 1.0)

        async def give(name, way):
            try:
                await operators.carry_out(parse(name, b"", way))
            except TooManyError as error:
                return str(error)
            except CommandError:
                return "not now"
            return "done"

        outcomes = await asyncio.gather(*(give("relearn", "MQTT") for _ in range(30)))
        refusal = "more than 2 commands a second came over MQTT; ask again in a second"
        assert [outcome for outcome in outcomes if outcome == refusal] == [refusal] * 10
        assert await give("auto", "HTTP") == "done"
        assert await give("stow", "MQTT") == "done"
        assert set(await asyncio.gather(*(give("stop", "MQTT") for _ in range(100)))) == {"done"}
        await asyncio.sleep(60)
        assert [await give("relearn", "MQTT") for _ in range(20)].count(refusal) == 0
        assert await give("auto", "MQTT") == refusal
        await asyncio.sleep(0.6)
        assert await give("auto", "MQTT") == "done"

    run_rig(scenario)


def test_a_stop_given_again_and_again_is_sent_five_times_a_second_and_anew_after_auto(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        sent = commands_sent(rig, monkeypatch)
        operator = Operator(rig.tracker, 1.0)

        def stops():
            return sum(data.startswith(b"$9s") for _, data in sent)

        giving = []
        for _ in range(1000):
            giving.append(asyncio.create_task(operator.stop("a flood")))
            await asyncio.sleep(0.001)
        answers = await asyncio.gather(*giving)
        assert {answer.seen for answer in answers} == {Effect.DONE}
        noted = [event for event in rig.records_of(Event) if event.subject == "operator"]
        assert 1 <= len(noted) <= 6
        await asyncio.sleep(5)
        before = stops()
        began_s, giving = rig.clock.monotonic(), []
        for command, why in ((operator.stop, "the first"), (operator.auto, "released"), (operator.stop, "once more")):
            giving.append(asyncio.create_task(command(why)))
            await asyncio.sleep(0.03)
        assert rig.clock.monotonic() - began_s < 0.2, "all three within the time in which a stop counts as the same"
        await asyncio.gather(*giving)
        assert stops() >= before + 2
        assert rig.control.wishes.stop.why == "once more"

    run_rig(scenario)


def test_commands_that_a_program_repeats_are_all_events_but_the_log_gives_only_their_number(run_rig, caplog):
    async def scenario(rig):
        await wait_for_tracking(rig)
        operator = Operator(rig.tracker, 1.0)
        with caplog.at_level(logging.INFO, "heliocube.operator"):
            for _ in range(200):
                await operator.auto("a script")
            await asyncio.sleep(3600)
        assert len([event for event in rig.records_of(Event) if event.subject == "operator"]) == 200

    run_rig(scenario)
    lines = [record.getMessage() for record in caplog.records if record.name == "heliocube.operator"]
    assert len(lines) == 52
    assert lines[-2].startswith("commands: 1 more, and only their number is logged")
    assert re.fullmatch(r"commands: 149 more, the last 3\d min ago", lines[-1])
