import fcntl
import json
import os
import struct
import subprocess
import sys
import termios
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from daemon.commands.answers import print_json
from daemon.commands.main import app
from daemon.commands.wrapping import wrapped
from tests.support import PATIENCE_S, ROOT, forks

# These run until they are ended, lead a person through something, write files of known names, or always answer in JSON.
WITHOUT = {
    "run", "archive", "bench", "dashboard", "notify", "setup", "config init", "config migrate", "samples", "bench-ctl",
}  # fmt: skip


@dataclass(frozen=True)
class Answer:
    value: float
    where: Path


def commands(command, path=()):
    inner = getattr(command, "commands", {})
    if not inner:
        yield " ".join(path), command
    for name, one in inner.items():
        yield from commands(one, (*path, name))


def test_every_command_that_ends_with_an_answer_gives_it_as_json_too():
    found = dict(commands(get_command(app)))
    without = {name for name, one in found.items() if not any("--json" in each.opts for each in one.params)}
    assert without <= WITHOUT


def test_printed_json_is_strict_also_for_nan_arrays_records_dates_and_paths(capsys):
    print_json({
        "none": float("nan"),
        "beyond": np.float64("inf"),
        "row": np.arange(2),
        "one": Answer(1.5, Path("a")),
        "when": datetime(2022, 10, 14, tzinfo=UTC),
        "degrees": "°",
        "path": Path(os.fsdecode(b"caf\xe9")),
    })  # fmt: skip
    out = capsys.readouterr().out
    assert out.isascii()
    assert json.loads(out, parse_constant=pytest.fail) == {
        "none": None,
        "beyond": None,
        "row": [0, 1],
        "one": {"value": 1.5, "where": "a"},
        "when": "2022-10-14T00:00:00Z",
        "degrees": "°",
        "path": "caf\udce9",
    }


def test_config_check_lists_problems_in_its_json_answer_and_on_standard_error(heliocube, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text('[law]\ndriver = "flat"\n')
    code, out, err = heliocube("config", "check", file, "--json")
    page = json.loads(out)
    assert (code, err, page["good"], page["problems"]) == (0, "", True, [])
    assert page["sets_up"]["law"].startswith("flat")
    file.write_text('[law]\ndrover = "flat"\n[site]\nlatitude_deg = 91\n')
    code, out, err = heliocube("config", "check", file, "--json")
    page = json.loads(out)
    assert (code, page["good"], len(page["problems"])) == (2, False, 2)
    assert all(problem in err for problem in page["problems"])


def test_a_refused_command_leaves_standard_output_empty(heliocube):
    code, out, err = heliocube("gain", "--lat", "95", "--json")
    assert (code, out) == (2, "")
    assert "95" in err
    code, out, err = heliocube("gain", "--lat", "45", "--json", "--format", "csv")
    assert (code, out) == (2, "")
    assert "leave out --format" in err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run --seed x", "Invalid value for '--seed': 'x' is not a whole number"),
        ("run --for nan", "Invalid value for '--for': 'nan' is not a number from 0 up"),
        ("run --role x", "Invalid value for '--role': 'x' is not one of 'both', 'cube', 'tracker'"),
        ("gain --lat 48,7", "Invalid value for '--lat': '48,7' is not a number"),
        ("gain --lat 4_8", "Invalid value for '--lat': '4_8' is not a number"),
        ("goto 1_5 60", "Invalid value for 'A': '1_5' is not a number"),
        ("campaign --seeds 1_0", "Invalid value for '--seeds': '1_0' is not a whole number"),
        ("goto west 60", "Invalid value for 'A': 'west' is not a number"),
        ("campaign --hours 1e9", "Invalid value for '--hours': '1e9' is not a number up to 8760"),
        *(
            (f"{command} {2**63}", f"'{2**63}' is not a number up to {2**63 - 1}")
            for command in (
                "run --seed",
                "simulate --out new --start 2022-10-12 --seed",
                "energy none.csv --site 48,2 --out new --seed",
                "compare simulate --out new --start 2022-10-12 --seed",
                "campaign --from",
            )
        ),
    ],
)
def test_a_mistyped_value_on_the_command_line_is_refused_in_plain_words(heliocube, words, sentence):
    code, out, err = heliocube(*words.split())
    assert (code, out) == (2, "")
    assert sentence in " ".join(err.translate({ord("│"): " "}).split())


def test_gain_gives_the_same_figures_as_json_and_as_a_csv_table(heliocube):
    arguments = ("gain", "--lat", "48.7", "--day", "10:12:1")
    table = heliocube(*arguments, "--format", "csv")[1].splitlines()
    rows = json.loads(heliocube(*arguments, "--json")[1])["rows"]
    assert [list(row) for row in rows] == [table[0].split(",")] * 3
    assert [[float(cell) for cell in line.split(",")] for line in table[1:]] == [list(row.values()) for row in rows]


def test_config_check_examines_the_people_file_of_the_notifications(heliocube, tmp_path):
    people = tmp_path / "notify.people"
    file = tmp_path / "heliocube.toml"
    file.write_text('[notify]\npeople_file = "notify.people"\n')
    code, out, _ = heliocube("config", "check", file, "--json")
    (problem,) = json.loads(out)["problems"]
    assert (code, problem.startswith(f"notify.people_file {people} does not exist")) == (2, True)
    people.touch(mode=0o600)
    people.write_text("# ours\nnowhere://lab?password=secret\n")
    (problem,) = json.loads(heliocube("config", "check", file, "--json")[1])["problems"]
    assert (
        problem
        == f"notify.people_file {people}, line 2: no address that apprise knows; write one such as ntfy://ntfy.lab/roof"
    )
    people.write_text("ntfy://ntfy.lab/roof\n")
    assert heliocube("config", "check", file)[0] == 0


def test_long_lines_are_wrapped_between_words_on_a_terminal_and_left_whole_in_a_file(tmp_path, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 30, 0, 0))
    text = "  store   the disk is full: free it\n/a/path/that/is/longer/than/thirty/columns of 2\nshort"
    with os.fdopen(ours, "wb"), os.fdopen(theirs, "w") as terminal, (tmp_path / "file").open("w") as file:
        assert wrapped(text, file) == text
        assert wrapped(text, terminal, hang=8).split("\n") == [
            "  store   the disk is full:",
            "          free it",
            "/a/path/that/is/longer/than/thirty/columns",
            "  of 2",
            "short",
        ]
        assert wrapped("  store  /a/path/that/needs/its/25 is full", terminal, hang=9).split("\n") == [
            "  store",
            "     /a/path/that/needs/its/25",
            "     is full",
        ]
        monkeypatch.setenv("COLUMNS", "40")
        assert wrapped("  store   the disk is full: free it", terminal) == "  store   the disk is full: free it"


def test_config_check_shows_a_path_that_is_longer_than_a_line_whole(tmp_path):
    records = tmp_path / "a-long-name-of-a-folder" / "of-somebody-who-likes-long-names"
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[store]\ndirectory = '{records}'\n")
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 60, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    with os.fdopen(ours, "rb"), os.fdopen(theirs, "wb") as terminal:
        code = forks.start(["config", "check", file], terminal, env=environment).wait(PATIENCE_S)
        said = os.read(ours, 100_000).decode()
    assert code == 0
    assert str(records) in said


# The last answer is longer than Python's buffer.
@pytest.mark.parametrize(
    "words",
    ["--version", "config check FILE", "config check FILE --json", "gain --lat 45", "gain --lat-range 0:65:1 --json"],
)
def test_an_answer_that_cannot_be_written_is_reported_in_one_sentence(tmp_path, words):
    file, told = tmp_path / "heliocube.toml", tmp_path / "told"
    file.touch()
    given = [file if word == "FILE" else word for word in words.split()]
    with Path("/dev/full").open("w") as full, told.open("w") as err:
        code = forks.start(given, full, err).wait(PATIENCE_S)
    why = "heliocube: the answer cannot be written to standard output: No space left on device\n"
    assert (code, told.read_text()) == (7, why)


@pytest.mark.parametrize("words", [["config", "check", "FILE"], ["gain", "--lat-range", "0:65:1", "--json"]])
def test_a_broken_pipe_on_standard_output_ends_with_code_7_and_no_message(tmp_path, words):
    file, told = tmp_path / "heliocube.toml", tmp_path / "told"
    file.touch()
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as pipe, told.open("w") as err:
        code = forks.start([file if word == "FILE" else word for word in words], pipe, err).wait(PATIENCE_S)
    assert (code, told.read_text()) == (7, "")


def test_a_closed_standard_output_causes_no_error():
    program = "from daemon.entry import main; main()"
    words = [sys.executable, "-c", program, "gain", "--lat", "45", "--format", "csv"]
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", *words], stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S, cwd=ROOT
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("closed", ["2>&-", "0<&- 2>&-"])
def test_a_closed_standard_error_changes_no_exit_code_and_its_descriptor_is_not_reused(tmp_path, closed):
    program = """
import os, sys
from pathlib import Path
from daemon.entry import main
try:
    main()
finally:
    Path(sys.argv[-1]).with_name("opened").write_text(str(os.open(sys.argv[0], os.O_RDONLY)))
"""
    (tmp_path / "program.py").write_text(program)
    words = [sys.executable, tmp_path / "program.py", "config", "check", tmp_path / "nothing.toml"]
    done = subprocess.run(["sh", "-c", f'exec "$@" {closed}', "sh", *words], timeout=PATIENCE_S, cwd=ROOT)
    assert done.returncode == 2
    assert int((tmp_path / "opened").read_text()) > 2


@pytest.mark.parametrize(
    ("library", "words", "sentence"),
    [
        ("typer", ["gain"], "interrupted before its end; no whole result was written"),
        ("daemon.base.installation", ["gain"], "interrupted before its end; no whole result was written"),
        ("daemon.api.client", ["stop"], "interrupted: the command may have been taken; see 'heliocube status'"),
    ],
)
@pytest.mark.parametrize("in_c", [False, True])
def test_ctrl_c_while_the_libraries_load_ends_with_one_sentence_and_code_130(library, words, sentence, in_c):
    program = f"""
import signal, sys

class CtrlC:
    def find_spec(self, name, *rest):
        if name == {library!r}:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt as error:
                if {in_c}:
                    # As pybind11 does, by which scipy is built.
                    raise ImportError("initialization failed") from error
                raise

sys.meta_path.insert(0, CtrlC())
from daemon.entry import main; main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program, *words], capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"heliocube: {sentence}\n")


def test_a_missing_folder_for_matplotlib_is_reported_in_a_sentence_without_a_traceback(tmp_path):
    program = "import tempfile; tempfile.tempdir = '/dev/null/x'; from daemon.entry import main; main()"
    words = ["gain", "--lat", "48", "--plot", str(tmp_path / "gain.png")]
    without_home = os.environ | {"MPLCONFIGDIR": "/dev/null/y"}
    command = [sys.executable, "-c", program, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT, env=without_home)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    words = "heliocube: matplotlib, which draws the pictures, needs a folder of its own, and"
    assert done.stderr.splitlines()[-1].startswith(words)


def test_a_figure_is_drawn_without_a_warning_when_the_home_cannot_be_written_to(tmp_path):
    figure = tmp_path / "gain.png"
    command = [sys.executable, "-m", "daemon.commands.main", "gain", "--lat", "48", "--plot", str(figure)]
    without_home = {name: text for name, text in os.environ.items() if not name.startswith("XDG_")}
    without_home |= {"HOME": "/dev/null", "MPLCONFIGDIR": "/dev/null/y"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT, env=without_home)
    assert (done.returncode, done.stderr) == (0, f"figure in {figure}\n")
