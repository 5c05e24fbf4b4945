"""One parser for commands, whatever way they come."""

import json
import math
import socket
import subprocess
import sys
import threading

import pytest

from daemon.service.operator import Operator
from daemon.service.operator_commands import MODES, NAMES, URGENT, BodyError, parse
from tests.support import ROOT


def test_every_command_is_one_of_the_operators_and_every_mode_a_command():
    assert all(callable(getattr(Operator, name)) for name in NAMES if name != "mode")
    assert set(MODES) | set(URGENT) < set(NAMES)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("goto", "mode")])
def test_an_empty_body_says_who_asked_by_the_way_it_came(name):
    command = parse(name, b"", "MQTT")
    assert (command.name, command.wanted, command.by, command.why) == (name, name, "MQTT", "an operator asked")
    assert command.identifier is None


def test_reason_person_and_identifier_are_taken_over():
    command = parse("goto", b'{"a_deg": -10, "b_deg": 60, "why": "test", "by": "ana@lab", "id": "7"}', "HTTP")
    assert (command.why, command.by, command.identifier) == ("test", "ana@lab", "7")
    assert (command.a_deg, command.b_deg) == (-10.0, 60.0)


@pytest.mark.parametrize("content", [b"snow", b'{"mode": "snow"}'])
def test_a_mode_is_a_word_or_an_object(content):
    assert parse("mode", content, "MQTT").wanted == "snow"


def test_a_number_beyond_every_float_is_for_the_limits_to_refuse():
    assert parse("goto", b'{"a_deg": 1' + b"0" * 400 + b', "b_deg": 60}', "HTTP").a_deg == math.inf


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("stop", b"halt!", "the body is not JSON"),
        ("stop", b"\xff\xfe", "the body is not JSON"),
        ("stop", b"[" * 4000, "the body is not JSON"),
        ("stop", b"[1]", 'the body is not a JSON object, such as {"why": "maintenance"}'),
        ("stop", b"x" * 4097, "the body is longer than 4096 bytes"),
        ("stop", b'{"when": 1}', "the body has 'when', but may have only why, by, id, tracker"),
        ("goto", b'{"c_deg": 1}', "the body has 'c_deg', but may have only a_deg, b_deg, why, by, id, tracker"),
        ("stop", b'{"why": 3}', '"why" must be one line of text with at most 200 letters'),
        ("stop", b'{"by": ""}', '"by" must be one line of text with at most 200 letters'),
        ("stop", b'{"by": "a\\nb"}', '"by" must be one line of text with at most 200 letters'),
        ("stop", b'{"id": null}', '"id" must be one line of text with at most 200 letters'),
        (
            "goto",
            b'{"a_deg": true, "b_deg": 60}',
            'goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}',
        ),
        ("goto", b"", 'goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}'),
        ("mode", b"", "the mode must be one of auto, hold, stow, snow, maintenance"),
        ("mode", b'{"mode": ["stow"]}', "the mode must be one of auto, hold, stow, snow, maintenance"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(name, content, sentence):
    with pytest.raises(BodyError) as refused:
        parse(name, content, "HTTP")
    assert str(refused.value) == sentence
    assert refused.value.wrong


def answering(reply):
    """Listen on loopback and answer one request with `reply`; return the port and what was heard."""
    listener = socket.create_server(("127.0.0.1", 0))
    heard = []

    def serve():
        connection, _ = listener.accept()
        with connection:
            content = b""
            while b"\r\n\r\n" not in content or b"}" not in content:
                content += connection.recv(65536)
            heard.append(json.loads(content.partition(b"\r\n\r\n")[2]))
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
        (409, {"error": "no goto: stopped"}, 2, "", "heliocube: no goto: stopped\n"),
    ],
)
def test_the_program_ends_with_what_was_seen(tmp_path, command, status, body, code, out, err):
    listener, heard = answering(f"HTTP/1.1 {status} x\r\n\r\n{json.dumps(body)}".encode())
    with listener:
        done = subprocess.run(
            [sys.executable, "-c", "from daemon.entry import main; main()", *command],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env={
                "HELIOCUBE_CONFIG": str(_config(tmp_path, listener.getsockname()[1])),
                "HELIOCUBE_TOKEN": "t" * 43,
                "PATH": "",
                "LOGNAME": "ana",
            },
            timeout=60,
        )
    assert (done.returncode, done.stdout, done.stderr) == (code, out, err)
    assert heard[0]["by"] == f"ana@{socket.gethostname()}"
    assert heard[0].get("tracker") == ("west" if "west" in command else None)


def _config(folder, port):
    path = folder / "heliocube.toml"
    path.write_text(f"[api]\nlisten = '127.0.0.1:{port}'\n")
    return path
