"""The service as real processes, commanded and killed as a person and a power cut would."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from daemon.api.token import generate_token, write_token
from tests.support import PATIENCE_S, ROOT, forks
from tests.system.processes import wait_until

pytestmark = pytest.mark.system


def heliocube(*arguments, **environment):
    clean = {key: value for key, value in os.environ.items() if not key.startswith("HELIOCUBE_")}
    done = forks.run(*arguments, cwd=ROOT, env=clean | environment | {"COLUMNS": "120"})
    return done.returncode, done.stdout, done.stderr


def test_killed_fifty_times_under_load_the_store_loses_no_more_than_a_batch(tmp_path):
    loop = [sys.executable, "-m", "tests.system.kill_loop", tmp_path / "store", "50", "1"]
    done = subprocess.run(loop, capture_output=True, text=True, cwd=ROOT, timeout=560)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert done.stdout.startswith("50 restarts, ")

    code, _, err = heliocube("export", "--store", tmp_path / "store", "--out", tmp_path / "out", "--format", "parquet")
    assert (code, err) == (0, "")
    scans = pd.read_parquet(tmp_path / "out" / "scans.parquet")
    assert not scans.duplicated(["source", "session", "sequence"]).any()
    # At 200 times real speed, a pause of seconds makes a scan too old for its receiver; no record is lost by that.
    assert all(run["sequence"].is_monotonic_increasing for _, run in scans.groupby("run"))


@pytest.fixture
def service(tmp_path):
    """A service with a store and a token; returns its configuration's path, the process and where it listens."""
    config = tmp_path / "heliocube.toml"
    config.write_text(
        "[bridge]\nlisten = '127.0.0.1:0'\n[store]\ndirectory = 'records'\nbatch_s = 0.2\n"
        "[api]\nlisten = '127.0.0.1:0'\ntoken_file = 'api.token'\n"
        # Slow enough that a person's next command finds it under way, on a busy machine too.
        "[simulation]\nmotor_speed_mm_s = 0.8\n"
    )
    write_token(tmp_path / "api.token", generate_token())
    told, tells = os.pipe()
    with os.fdopen(tells, "wb") as output, Path(os.devnull).open("wb") as nowhere:
        process = forks.start(["run", "--config", config, "--speed", "60"], output, nowhere, cwd=ROOT)
    said = os.fdopen(told, encoding="utf-8")
    line = said.readline()
    found = re.match(r"local interface at http://(.*); the token of commands is in (.*)\n", line)
    assert found, line
    assert found[2] == str(tmp_path / "api.token")
    yield config, process, found[1]
    process.kill()
    process.wait()
    said.close()


def test_a_person_at_a_terminal_sees_and_commands_the_service(service, tmp_path):
    config, process, address = service
    at = ("--api", address)
    token = ("--token-file", tmp_path / "api.token")

    code, out, err = heliocube("status", *at)
    assert (code, err) == (0, "")
    assert out.startswith("heliocube SIMULATED both at SIRTA, 60 x real time\n")
    for name in ("time", "mode", "tracker", "bridge", "store"):
        assert re.search(rf"^{name} ", out, re.MULTILINE), out
    assert "\x1b" not in out
    assert json.loads(heliocube("status", "--json", *at)[1])["simulated"] is True

    # It refuses a goto until it knows where it stands and what the cube sees.
    wait_until(lambda: json.loads(heliocube("status", "--json", *at)[1])["mode"]["name"] != "starting", "started")
    code, out, err = heliocube("goto", "-30", "60", *at, *token, "--why", "shading test")
    assert (code, out[:26], err) == (0, "moving to A -30.0, B 60.0 ", "")
    code, out, err = heliocube("goto", "-70", "60", *at, *token)
    assert (code, out) == (2, "")
    assert err == "heliocube: A -70, B 60 deg is outside the limits (A -50..50 deg, B 15..90 deg)\n"

    wait_until(
        lambda: json.loads(heliocube("status", "--json", *at)[1])["tracker"]["pose"]["a_deg"] < -25.0, "turned away"
    )

    config.write_text(config.read_text().replace("[api]\nlisten = '127.0.0.1:0'", f"[api]\nlisten = '{address}'"))
    code, out, err = heliocube("stow", "--config", config)
    assert (code, err) == (0, "")
    assert re.fullmatch(r"(moving to|standing at) A \+0\.0, B 90\.0 deg.*; mode stow: an operator asked\n", out), out
    code, out, err = heliocube("stop", "--json", HELIOCUBE_CONFIG=str(config))
    assert (code, err) == (0, "")
    assert (said := json.loads(out))["state"] == "done", out
    expected = r"standing at A .*; mode hold: stopped by \S+@\S+ since .* UTC: an operator asked; "
    assert re.search(expected, said["text"]), said
    code, out, err = heliocube("goto", "-30", "60", "--config", config)
    assert (code, out) == (6, "")
    assert re.fullmatch(r"heliocube: no goto: the tracker is stopped by .*; only 'heliocube auto' releases it\n", err)
    out = heliocube("status", "--config", config)[1]
    assert re.search(r"^stop +by \S+@\S+ since .*: an operator asked *$", out, re.MULTILINE), out
    assert re.search(r"^alarm +stow is wanted", out, re.MULTILINE), out
    assert re.search(r"^mode +hold STOPPED since ", out, re.MULTILINE), out
    code, out, err = heliocube("status", "--check", "--config", config)
    assert (code, err) == (4, "")
    first, second = out.splitlines()
    assert first == "works, but 1 to look at: SIMULATED, hold, STOPPED by a person"
    assert re.match(r"stow-wanted \(raised, since [-0-9]+ [0-9:]+ (\([-0-9: ]+ )?UTC\)?\): stow is", second), out

    local = r"since ([-0-9]{10} )?[:0-9]{8} \([-0-9: ]+ UTC\): an operator asked"
    for order in (("stop",), ("goto", "-30", "60"), ("alarms",)):
        told = " ".join("".join(heliocube(*order, "--config", config, TZ="Europe/Paris")[1:]).split())
        assert re.search(local, told), told
        assert not re.search(r"[^(]\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", told), told

    code, out, err = heliocube("stop", *at, HELIOCUBE_TOKEN="x" * 43)
    assert (code, out, err) == (
        6,
        "",
        "heliocube: the token is not the service's: restart the service after a change of api.token_file\n",
    )
    code, out, err = heliocube("stop", *at)
    assert (code, out) == (2, "")
    assert err.startswith("heliocube: 'stop' needs the service's token: ")
    assert err.count("\n") == 1

    code, out, err = heliocube("export", "--config", config, "--out", tmp_path / "day", "--kind", "moves")
    assert (code, err) == (0, "")

    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=PATIENCE_S) == 0
    code, out, err = heliocube("status", "--check", *at)
    assert (code, out) == (5, "")
    assert err == (
        f"heliocube: nothing listens at {address}: the service is not running, or its api.listen is another address\n"
    )


@pytest.fixture
def no_store(tmp_path):
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "heliocube.sqlite").write_bytes(b"SQLite format 3\0" + bytes(5000))
    return tmp_path / "records"


def test_a_service_that_finds_a_foreign_file_as_its_store_starts_and_shows_that_it_moved_it_aside(no_store, service):
    _, _, address = service
    # The store's thread moves the file while the service starts.
    out = wait_until(lambda: "moved aside" in (out := heliocube("status", "--api", address)[1]) and out, "alarm")
    assert re.search(
        r"^alarm +a file that is no store of heliocube, or one with a damaged beginning, was moved aside as ",
        out,
        re.MULTILINE,
    ), out
    (aside,) = no_store.glob("heliocube.*.foreign.sqlite")
    assert aside.read_bytes() == b"SQLite format 3\0" + bytes(5000)
    wait_until(lambda: json.loads(heliocube("status", "--json", "--api", address)[1])["store"]["written"], "rows")


def test_the_stop_command_works_with_a_mistake_elsewhere_in_the_configuration(service, tmp_path):
    config, _, address = service
    token = tmp_path / "api.token"
    config.write_text(f"[site]\nlatitude_deg = 'north'\n[api]\nlisten = '{address}'\ntoken_file = '{token}'\n")
    code, out, err = heliocube("stop", "-c", config)
    assert (code, err) == (0, "")
    assert "; mode " in out


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[api", "{config} is not TOML: "),
        ("api = 3", "the [api] of {config} is wrong; see 'heliocube config check {config}'"),
        ("[api]\nlisten = 'here'", "api.listen: 'here' is not an address and a port"),
        ("[api]\ntoken_file = 'none'", "the token file {folder}/none does not exist: copy a new one from a new folder"),
        ("[api]\ntoken_file = 'open'", "the token file {folder}/open is open to others than its owner"),
        ("[api]\ntoken_file = 'short'", "the token file {folder}/short is not one line of 32 to 512 letters"),
    ],
)
def test_the_stop_command_refuses_a_configuration_with_wrong_api_settings_in_one_sentence(tmp_path, text, sentence):
    config = tmp_path / "heliocube.toml"
    config.write_text(text)
    write_token(tmp_path / "open", generate_token())
    (tmp_path / "open").chmod(0o644)
    write_token(tmp_path / "short", "abc")
    code, out, err = heliocube("stop", "--config", config)
    assert (code, out) == (2, "")
    assert err.startswith(f"heliocube: {sentence.format(config=config, folder=tmp_path)}")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "words", [["stop"], ["stow", "--api=127.0.0.1:1"], ["stop", "--why", "a hand", "--api", "127.0.0.1:1"]]
)
def test_an_urgent_command_loads_no_large_library(tmp_path, words):
    shutil.rmtree(tmp_path)
    code = (
        f"import sys; sys.argv = ['heliocube', *{words}]\n"
        "from daemon.entry import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "large = {'typer', 'rich', 'numpy', 'pandas', 'pydantic', 'pvlib', 'http.client', 'ssl'} & set(sys.modules)\n"
        "assert not large, large"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True)


def test_after_a_change_of_release_the_service_holds_the_tracker_and_states_the_reason(tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        "[bridge]\nlisten = '127.0.0.1:0'\n[store]\ndirectory = 'records'\n[api]\nenabled = false\n"
        "[simulation]\nspeed = 60\n"
    )
    records = tmp_path / "records"
    records.mkdir()
    (records / "release.json").write_text('{"release": "0.0.9"}')
    code, _, err = heliocube("run", "--config", config, "--for", "5")
    assert code == 0, err
    hold = json.loads((records / "operator.json").read_text())["hold"]
    assert hold["by"] == "heliocube"
    assert hold["why"].startswith("the program was changed from 0.0.9 to 0.1.0")
    assert json.loads((records / "release.json").read_text())["release"].startswith("0.1.0")
    code, out, err = heliocube("export", "--store", records, "--out", tmp_path / "out", "--format", "parquet")
    assert (code, err) == (0, "")
    assert "0 moves" in out
    assert set(pd.read_parquet(tmp_path / "out" / "modes.parquet")["after"]) == {"hold"}
    code, _, err = heliocube("run", "--config", config, "--for", "0")
    assert code == 0, err
    assert json.loads((records / "operator.json").read_text())["hold"] == hold, "another restart is no release"
