"""Whatever is in a file, the list of its mistakes comes soon: seeded mutations of good files."""

import os
import sys
import time
from random import Random

import pytest

from daemon.base.errors import UserError
from daemon.commands.config import write_example
from daemon.commands.file_check import check_file
from daemon.commands.main import main
from daemon.config.file import ConfigError, load_settings
from daemon.config.migrate import migrate
from daemon.config.template import render_config
from daemon.cube.calibration import read_calibration

pytestmark = pytest.mark.slow

# One second of the process' own time, and as much again for whatever else the machine does. The defects that this limit
# guards against took minutes.
WITHIN_CPU_S = 5.0
FILES = 160
TRACKERS = """
[[tracker]]
name = "east"
[tracker.instruments.positioner]
port = "/dev/a"
[[tracker]]
name = "west"
site = { latitude_deg = 48.0 }
[tracker.law]
driver = "flat"
"""
CALIBRATION = """
identifier = "x"
method = "beside"
calibrated_utc = 2026-01-01T00:00:00Z
[east]
gain_w_m2_per_mv = 1.0
"""
NASTY = [
    "1" * 5000,
    "-" + "9" * 4000,
    "9223372036854775808",
    "1e999",
    "nan",
    "-inf",
    "[" * 480 + "]" * 480,
    "[" * 5000,
    "{a=" * 480 + "1" + "}" * 480,
    "[" * 60 + "]" * 60,
    '"~nosuchuser/x"',
    '"~"',
    '"a\\u0000b"',
    '"\\u202e"',
    '"' + "x" * 5000 + '"',
    '""',
    "'/dev/zero'",
    "'/proc/self/mem'",
    "1979-05-27T07:32:00Z",
    "[[1, 2], {a = 1}]",
    "true",
    "0x" + "f" * 300,
    '"""\n' + "line\n" * 300 + '"""',
    ".".join("a" * 40000),
]
LINES = [
    ".".join("a" * 40000) + " = 1",
    "[" + ".".join("a" * 40000) + "]",
    "\n".join(f"key_{n} = {n}" for n in range(1500)),
    "\n".join(f"latitude_{n}_deg = 1" for n in range(1500)),
    "\n".join(f"[[tracker]]\nname = 'n{n}'" for n in range(300)),
    "[[tracker]]",
    "tracker = 3",
    "[site]",
    "'\\u0000' = 1",
    '"a\\u0000" = 1',
    "\x00",
    "=" * 1000,
    "# " + "." * 500,
    "a" * 100_000 + " = 1",
]


def mutated(text, random):
    """Return a text with one to three of its places spoiled."""
    lines = text.split("\n")
    for _ in range(random.randint(1, 3)):
        place = random.randrange(len(lines))
        kind = random.randrange(6)
        if kind <= 2:
            keys = [number for number, line in enumerate(lines) if "=" in line and not line.startswith("# ")]
            place = random.choice(keys)
            lines[place] = lines[place].lstrip("# ").partition("=")[0] + "= " + random.choice(NASTY)
        elif kind == 3:
            lines.insert(place, random.choice(LINES))
        elif kind == 4:
            lines[place] = "".join(
                chr(random.choice([random.randrange(32, 127), random.randrange(0x2FFF)])) for _ in range(30)
            )
        else:
            del lines[place : place + random.randint(1, 4)]
    content = "\n".join(lines).encode("utf-8", "surrogatepass")
    if random.random() < 0.1:
        spoiled = bytearray(content)
        spoiled[random.randrange(len(spoiled))] = random.randrange(256)
        content = bytes(spoiled)
    return content


def in_time(read, path):
    """Return what reading a file raises, a sentence for people, or None; anything else fails."""
    begun_s = time.process_time()
    try:
        read(path)
        found = None
    except UserError as error:
        found = error
    taken_s = time.process_time() - begun_s
    assert taken_s < WITHIN_CPU_S, (
        f"{read.__name__} took {taken_s:.1f} s of processor time for {path.read_bytes()[:300]!r}"
    )
    return found


def test_a_mutated_file_is_accepted_or_refused_with_a_printable_list_within_5_s(tmp_path):
    write_example(tmp_path / "good", "both")
    good = [render_config("both"), render_config("tracker", {"mqtt.prefix": "x"}) + TRACKERS]
    load_settings(tmp_path / "good" / "heliocube.toml")
    refused = 0
    for seed in range(FILES):
        random = Random(seed)
        path = tmp_path / "heliocube.toml"
        path.write_bytes(mutated(random.choice(good), random))
        found = in_time(check_file, path)
        if found is not None:
            refused += 1
            assert isinstance(found, ConfigError)
            assert len(str(found)) < 500_000
            assert str(found).replace("\n", "").isprintable(), str(found)[:300]
        if seed % 4 == 0:
            (tmp_path / "heliocube.toml.before").unlink(missing_ok=True)
            in_time(migrate, path)
        path.write_bytes(mutated(CALIBRATION, random))
        assert in_time(read_calibration, path) is not None
    assert FILES / 4 < refused < FILES


@pytest.mark.parametrize("nasty", [*NASTY, *LINES])
def test_config_check_of_a_nasty_value_ends_with_exit_code_0_or_2_and_no_traceback(
    tmp_path, monkeypatch, capsys, nasty
):
    path = tmp_path / "heliocube.toml"
    text = f"[store]\ndirectory = {nasty}\n" if nasty in NASTY else nasty
    path.write_text(text)
    monkeypatch.setattr(sys, "argv", ["heliocube", "config", "check", str(path)])
    with pytest.raises(SystemExit) as ended:
        main()
    written = capsys.readouterr()
    assert ended.value.code in ((0, 2) if "deg" not in nasty else (2,))
    if ended.value.code == 2:
        assert written.out == ""
        assert written.err.startswith(f"heliocube: {path} has ")
        assert "Traceback" not in written.err


def test_a_pipe_in_place_of_a_file_is_refused_without_waiting(tmp_path):
    pipe = tmp_path / "heliocube.toml"
    os.mkfifo(pipe)
    with pytest.raises(ConfigError, match="the file is not an ordinary one, but a device or a pipe"):
        load_settings(pipe)
    config = tmp_path / "config.toml"
    for key in ("bridge.key_file", "api.token_file", "mqtt.credentials_file", "cube.calibration_file"):
        config.write_text(f"{key} = 'heliocube.toml'\n")
        with pytest.raises(ConfigError, match="not an ordinary"):
            check_file(config)
