"""`heliocube setup` without moves: what it writes, what it leaves alone, and how a person leaves it."""

import grp
import os
import pwd
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from daemon.bridge.signing import generate_key, load_key, write_key
from daemon.commands.main import app
from daemon.commands.setup.command import INTERRUPTED_EXIT_CODE
from daemon.commands.setup.finish import start_lines
from daemon.commands.setup.saved_answers import load_answers
from daemon.config.file import load_settings
from tests.daemon.store.test_full_disk import fill, small_disk
from tests.support import ROOT

__all__ = ["small_disk"]

CUBE = ["real", "Roof", "48.7", "2.2", "156", "yes", "modbus", "tcp:192.168.1.40:502", "skip", "10.0.0.5:20571"]


@pytest.fixture
def setup(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")

    def run(file, *said, options=("--role", "cube")):
        return CliRunner().invoke(app, ["setup", str(file), *options], input="".join(f"{text}\n" for text in said))

    return run


def test_setup_of_a_cube_without_a_terminal_prints_plain_lines_without_colour(setup, tmp_path):
    file = tmp_path / "cube.toml"
    done = setup(file, *CUBE, "new")
    assert done.exit_code == 0, done.output
    assert "\x1b" not in done.output
    lines = [line for line in done.output.splitlines() if ": " not in line and str(tmp_path) not in line]
    assert max(map(len, lines)) <= 80
    flat = "".join(done.output.split())
    assert f"readthecube:heliocubeprobe,with--config{file}" in flat
    assert f"heliocuberun--rolecube--config{file}" in flat
    found = load_settings(file)
    assert found.real
    assert found.bridge.send_to == ("10.0.0.5:20571",)
    assert load_key(tmp_path / "bridge.key")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["api.token", "bridge.key", "cube.toml"]


def test_setup_keeps_existing_settings_and_a_copy_of_the_file_and_overwrites_no_key(setup, tmp_path):
    file, key = tmp_path / "cube.toml", tmp_path / "bridge.key"
    before = "[cube]\nname = 'roof'\n[bridge]\nkey_file = 'bridge.key'\n[store]\ndirectory = 'kept'\n"
    file.write_text(before)
    write_key(key, generate_key())
    secret = key.read_bytes()
    for name in ("cube.toml.before", "cube.toml.before-2"):
        done = setup(file, *CUBE, "")
        assert done.exit_code == 0, done.output
        assert (tmp_path / name).exists()
    assert (tmp_path / "cube.toml.before").read_text() == before
    assert key.read_bytes() == secret
    found = load_settings(file)
    assert (found.cube.name, found.store.directory) == ("roof", tmp_path / "kept")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
def test_a_key_made_by_root_belongs_to_the_user_of_the_service_as_after_an_installation(setup, tmp_path):
    # As deploy/heliocube.tmpfiles.conf sets the owners; 'daemon' stands for the user and group 'heliocube'.
    user, group = pwd.getpwnam("daemon").pw_uid, grp.getgrnam("daemon").gr_gid
    (tmp_path / "api.token").write_text("t" * 40)
    os.chown(tmp_path / "api.token", 0, group)
    done = setup(tmp_path / "cube.toml", *CUBE, "new")
    assert done.exit_code == 0, done.output
    found = {path.name: path.stat() for path in tmp_path.iterdir()}
    assert {name: (of.st_uid, of.st_gid) for name, of in found.items()} == {
        "api.token": (0, group),
        "bridge.key": (user, group),
        "cube.toml": (0, group),
    }
    assert found["bridge.key"].st_mode & 0o777 == 0o600


def test_setup_on_a_full_disk_leaves_the_existing_configuration_unchanged(setup, small_disk, tmp_path):
    file = small_disk / "cube.toml"
    said = setup(file, *CUBE, "new")
    assert said.exit_code == 0, said.output
    before = file.read_text()
    # Room for the copy of the old file and for the answers, and for nothing else.
    spare = small_disk / "spare"
    spare.write_bytes(b"x" * 4096 * (len(before) // 4096 + 3))
    fill(small_disk / "filler")
    spare.unlink()
    done = setup(file, *CUBE, "")
    assert str(done.exception) == f"{small_disk} cannot be written: No space left on device"
    assert (small_disk / "cube.toml.before").read_text() == before
    assert file.read_text() == before


def test_setup_leaves_at_the_end_of_its_input_and_the_same_command_continues_later(setup, tmp_path):
    file = tmp_path / "rig" / "cube.toml"
    left = setup(file, *CUBE[:4])
    assert left.exit_code == INTERRUPTED_EXIT_CODE
    assert "Left." in left.output
    assert not file.exists()
    done = setup(file, *CUBE[4:], "new", options=())
    assert "5 answers are there from before" in done.output
    assert done.exit_code == 0, done.output
    assert load_settings(file).site.longitude_deg == 2.2
    again = setup(file, options=("--anew",))
    assert "What will this machine do" in again.output


def test_setup_refuses_another_role_than_its_kept_answers_have_and_keeps_them_unchanged(setup, tmp_path):
    file = tmp_path / "cube.toml"
    assert setup(file, "real", options=("--role", "both")).exit_code == INTERRUPTED_EXIT_CODE
    kept = (tmp_path / "cube.setup.json").read_text()
    other = setup(file, *CUBE)
    assert str(other.exception).startswith("--role cube: the answers from before in ")
    assert "are for the role both; leave --role out to go on with them, or begin with --anew" in str(other.exception)
    assert (tmp_path / "cube.setup.json").read_text() == kept
    assert setup(file, options=("--role", "both")).exit_code == INTERRUPTED_EXIT_CODE


def test_setup_refuses_kept_answers_for_a_missing_bench_and_names_the_way_out(setup, tmp_path):
    file, bench = tmp_path / "rig.toml", tmp_path / "bench" / "heliocube.toml"
    bench.parent.mkdir()
    bench.write_text("[instruments]\nkind = 'real'\nbench = true\n")
    assert setup(file, "bench", str(bench.parent), options=("--role", "both")).exit_code == INTERRUPTED_EXIT_CODE
    bench.unlink()
    for options in ((), ("--role", "both")):
        gone = str(setup(file, options=options).exception)
        assert gone.startswith(f"the answers from before in {tmp_path / 'rig.setup.json'} are for a bench, and")
        assert gone.endswith("start the bench again, or begin with --anew")
    assert "are for the role both" in str(setup(file, options=("--role", "cube")).exception)
    assert setup(file, options=("--anew",)).exit_code == INTERRUPTED_EXIT_CODE


def test_setup_offers_no_default_for_the_example_site_of_the_installed_configuration(setup, tmp_path):
    file = tmp_path / "tracker.toml"
    shutil.copy(ROOT / "deploy" / "examples" / file.name, file)
    done = setup(file, "real", "", "Roof", "", "48.7", "", "2.2", "", "156.5", options=("--role", "tracker"))
    assert done.output.count("this has no default") == 4
    assert "Does that fit the clock" in done.output


def test_setup_moves_nothing_without_a_terminal_whose_keys_could_stop_the_move(setup, tmp_path):
    port = tmp_path / "positioner"
    said = ["real", "Roof", "48.7", "2.2", "156", "yes", "5", "pozsol", str(port), "skip", "none", "", "new", *[""] * 7]
    done = setup(tmp_path / "tracker.toml", *said, "move", "skip", options=("--role", "tracker"))
    assert done.exit_code == 0, done.output
    assert "nothing is moved without a terminal" in done.output
    assert "THE FIRST MOVE" in done.output


@pytest.mark.parametrize(
    ("file", "role", "lines"),
    [
        ("/etc/heliocube/cube.toml", "cube", ["sudo systemctl start heliocube-cube"]),
        (
            "/etc/heliocube/tracker.toml",
            "tracker",
            [
                "switch the motors' supply off: docs/install.md, section 6",
                "sudo systemctl start heliocube-tracker; heliocube hold",
            ],
        ),
        ("/etc/heliocube/tracker.toml", "both", ["heliocube run --role both --config /etc/heliocube/tracker.toml"]),
        ("/home/me/tracker.toml", "tracker", ["heliocube run --role tracker --config /home/me/tracker.toml"]),
    ],
)
def test_setup_advises_starting_an_installed_service_by_its_unit_and_holding_the_tracker(file, role, lines):
    assert start_lines(Path(file), role) == lines


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """The folder of configurations of an installed machine, each file with the unit that reads it."""
    monkeypatch.setattr("daemon.commands.options.CONFIG_FOLDER", tmp_path)
    return tmp_path


def test_setup_of_a_units_file_takes_the_role_and_the_store_folder_of_that_unit(setup, installed):
    file = installed / "cube.toml"
    done = setup(file, *CUBE, "new", options=())
    assert done.exit_code == 0, done.output
    assert "What will this machine do" not in done.output
    assert "sudo systemctl start heliocube-cube" in done.output
    assert load_settings(file).store.directory == Path("/var/lib/heliocube/cube")


@pytest.mark.parametrize(("name", "role"), [("both", "both"), ("tracker", "both"), ("tracker", "cube")])
def test_on_an_installed_machine_a_role_that_no_unit_starts_is_refused(setup, installed, name, role):
    refused = setup(installed / f"{name}.toml", *CUBE, options=("--role", role))
    assert str(refused.exception).startswith(f"no unit starts {installed / name}.toml as {role}: cube and tracker are")
    assert not list(installed.iterdir())
    asked = setup(installed / "rig.toml", "both", options=())
    assert "cube and tracker are two units" in " ".join(asked.output.split())


def test_setup_refuses_a_folder_that_takes_no_file_before_anything_is_asked(setup, tmp_path):
    (tmp_path / "file").write_text("")
    done = setup(tmp_path / "file" / "cube.toml", *CUBE)
    assert "cannot be written" in str(done.exception)
    assert "name a file in a folder of yours" in str(done.exception)


# As with a terminal whose locale is fr_FR.UTF-8, for example; C.UTF-8 takes any byte.
@pytest.mark.parametrize("encoding", ["utf-8:strict", "ascii:strict"])
def test_setup_asks_again_after_a_letter_in_another_encoding_than_the_terminals(tmp_path, encoding):
    done = subprocess.run(
        [sys.executable, "-c", "from daemon.entry import main; main()", "setup", str(tmp_path / "rig.toml")],
        input=b"both\nreal\nCaf\xe9\nCafe\n",
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": encoding},
    )
    assert (done.returncode, done.stderr) == (INTERRUPTED_EXIT_CODE, b"")
    assert b"or a letter" in done.stdout
    assert load_answers(tmp_path / "rig.setup.json").answers["site.name"] == "Cafe"


@pytest.mark.timeout(20)
def test_a_pipe_in_place_of_the_kept_answers_is_refused_unless_setup_begins_anew(setup, tmp_path):
    answers = tmp_path / "rig.setup.json"
    os.mkfifo(answers)
    refused = str(setup(tmp_path / "rig.toml").exception)
    assert refused == f"{answers} is no ordinary file, but a device or a pipe: remove it, or begin with --anew"
    assert setup(tmp_path / "rig.toml", "real", options=("--anew",)).exit_code == INTERRUPTED_EXIT_CODE
    assert answers.is_file()
