"""The commands agree on the folder of a service whose file names none."""

import csv
import socket
from pathlib import Path

import pytest

from daemon.commands.records_folder import find_records_folder, with_default_store_folder
from daemon.config.settings import Settings
from daemon.store.records_folder import lock_folder
from tests.support import forks

FILE = Path("rig/heliocube.toml")
REAL = Settings.model_validate({"instruments": {"kind": "real"}})
NAMED = Settings.model_validate({"instruments": {"kind": "real"}, "store": {"directory": "elsewhere"}})


@pytest.mark.parametrize(
    ("settings", "file", "found"),
    [(REAL, FILE, "rig/records"), (NAMED, FILE, "elsewhere"), (Settings(), FILE, None), (REAL, None, None)],
)
def test_a_rig_of_real_instruments_has_a_default_store_folder_and_a_simulated_rig_has_none(settings, file, found):
    wanted = None if found is None else Path(found)
    assert with_default_store_folder(settings, file, {}).store.directory == wanted
    if file is not None:
        assert find_records_folder(settings, file, {}) == wanted


def heliocube(*words):
    done = forks.run(*words)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(("role", "name"), [("both", "tracker"), ("cube", "cube")])
def test_records_of_a_rig_without_a_name_are_exported_under_the_name_in_its_topics(tmp_path, role, name):
    file = tmp_path / "rig.toml"
    file.write_text(
        f'[store]\ndirectory = "{tmp_path}"\n[bridge]\ninsecure = true\nlisten = "127.0.0.1:0"\n'
        "[api]\nenabled = false\n[simulation]\nspeed = 20.0\n"
    )
    assert heliocube("run", "--role", role, "--config", file, "--for", "0.5")[0] == 0
    assert heliocube("export", "-c", file, "--out", tmp_path / "out", "--kind", "scans")[0] == 0
    with (tmp_path / "out" / "scans.csv").open() as rows:
        assert {row["tracker"] for row in csv.DictReader(rows)} == {name}


def test_two_services_with_one_store_folder_record_no_change_of_their_configurations(tmp_path):
    for role in ("cube", "tracker"):
        file = tmp_path / f"{role}.toml"
        file.write_text(
            f'[store]\ndirectory = "{tmp_path}"\n[bridge]\ninsecure = true\nlisten = "127.0.0.1:0"\n'
            f'[api]\nenabled = false\n[mqtt]\nname = "{role}"\n'
        )
        assert heliocube("run", "--role", role, "--config", file, "--for", "0.2")[0] == 0
    assert heliocube("export", "--store", tmp_path, "--out", tmp_path / "out", "--kind", "events")[0] == 0
    with (tmp_path / "out" / "events.csv").open() as rows:
        assert [row["text"] for row in csv.DictReader(rows) if row["subject"] == "configuration"] == []


def test_export_finds_the_default_store_folder_and_a_second_service_is_refused_it(tmp_path):
    file, kept = tmp_path / "east.toml", tmp_path / "east-records"
    file.write_text(
        '[instruments]\nkind = "real"\n[instruments.positioner]\nport = "/dev/no-such-port"\n'
        '[bridge]\ninsecure = true\nlisten = "127.0.0.1:0"\n[api]\nenabled = false\n'
    )
    run = ("run", "--role", "tracker", "--config", file, "--for", "0.3")
    with lock_folder(kept, ("tracker",)):
        before = sorted(kept.iterdir())
        code, _, err = heliocube(*run)
        assert (code, sorted(kept.iterdir())) == (2, before)
        assert err.startswith("heliocube: another service that runs keeps records and state of")
        assert f" in {kept}; stop that service first" in err
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        other = tmp_path / "west.toml"
        other.write_text(file.read_text().replace("127.0.0.1:0", f"127.0.0.1:{taken.getsockname()[1]}"))
        code, _, err = heliocube("run", "--role", "tracker", "--config", other, "--for", "0.3")
        assert (code, "is in use by another program" in err) == (2, True)
        assert not [path for path in (tmp_path / "west-records").iterdir() if path.suffix == ".sqlite"]
        assert not (tmp_path / "west-records" / "configuration.json").exists()
    assert heliocube(*run)[0] == 0
    assert {"heliocube.sqlite", "started.json"} <= {path.name for path in kept.iterdir()}
    code, _, err = heliocube("export", "-c", file, "--out", tmp_path / "out", "--kind", "events")
    assert (code, err, (tmp_path / "out" / "events.csv").is_file()) == (0, "", True)
    assert "motion is NOT known to be stopped: tracker" in heliocube(*run)[1]
