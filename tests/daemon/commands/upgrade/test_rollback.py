"""The way back to the release before: the tracker is held, the records since then come along, nothing newer is lost."""

import json
import os
import re
import shutil
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace

import pytest

from daemon.base.clock import SystemClock
from daemon.base.installation import release
from daemon.config.migrate import backup_path
from daemon.store.copies import copies_of, copy_path
from daemon.store.records_folder import lock_folder
from daemon.store.schema import FILE_NAME, VERSION
from daemon.store.store import Store
from tests.daemon.store.test_copies import OLDER, made_older, opened
from tests.daemon.store.test_store import ORIGIN, count
from tests.daemon.store.test_tables import ALL, scan
from tests.daemon.store.test_unusable_store import until
from tests.support.disk import synced_files

__all__ = ["synced_files"]


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text("[store]\ndirectory = 'records'\n")
    return file


@pytest.fixture
def program(tmp_path):
    """Install a heliocube of another release, which knows one version of stores and refuses files with a key."""

    def make(version=OLDER, *, refuses="no key", prefix=None, release="echo 0.0.9+4f1c"):
        folder = (prefix or tmp_path / "0.0.9") / "bin"
        folder.mkdir(parents=True, exist_ok=True)
        asked = f"case $2 in *release*) {release} ;; *) echo {version} ;; esac"
        check = f'test -r "$3" && ! grep -q \'^{refuses} =\' "$3"'
        told = {"heliocube": check, "python": asked}
        for name, does in told.items():
            (folder / name).write_text(f"#!/bin/sh\n{does}\n")
            (folder / name).chmod(0o755)
        (folder.parent / ".complete").touch()
        return folder / "heliocube"

    return make


@pytest.fixture
def upgraded(tmp_path):
    """A store of the version before, in which this release has kept records since; returns its folder."""
    folder = tmp_path / "records"
    store = opened(folder)
    for number in range(5):
        store.keep(scan(number))
    store.close()
    made_older(folder)
    store = opened(folder)
    for record in (*ALL, *(scan(number) for number in range(100, 110))):
        store.keep(record)
    store.close()
    assert copies_of(folder) == [copy_path(folder / FILE_NAME, OLDER)]
    return folder


def tables(folder):
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        return version, {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def test_rollback_restores_the_older_store_with_the_records_since_and_keeps_the_newer_store(
    heliocube, config, program, upgraded
):
    scans, decisions = count(upgraded, "scans"), count(upgraded, "decisions")
    code, out, err = heliocube("rollback", "-c", config, "--to", program())
    assert (code, err) == (0, "")
    version, names = tables(upgraded)
    assert (version, "curves" in names) == (OLDER, False)
    assert (count(upgraded, "scans"), count(upgraded, "decisions")) == (scans, decisions)
    with closing(sqlite3.connect(upgraded / FILE_NAME)) as connection:
        assert connection.execute("SELECT run, version FROM runs").fetchall() == [(1, "0.1.0"), (2, "0.1.0")]
        assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    (newer,) = upgraded.glob("heliocube.newer-*.sqlite")
    assert str(newer) in out
    # The curve and the two scans from before do not count, and a run is not a record.
    assert re.findall(r"with (\d+) records that came since", out) == ["16"]
    with closing(sqlite3.connect(newer)) as connection:
        assert connection.execute("SELECT count(*) FROM curves").fetchone()[0] == 1
    assert copies_of(upgraded) == []

    code, out, _ = heliocube("rollback", "-c", config, "--to", program())
    assert code == 0
    assert "records/heliocube.sqlite: 0.0.9 can use it as it is" in out


def test_rollback_also_takes_over_records_kept_by_a_service_that_was_not_restarted(
    heliocube, config, program, tmp_path
):
    """It may be the cube's service, beside a newer tracker's in one folder: its run is older than the copy."""
    folder = tmp_path / "records"
    of_before = Store(folder, 0.05, 400, ORIGIN, SystemClock(), lambda event: None)
    of_before.keep(scan(0))
    until(lambda: of_before.status.written == 1)
    made_older(folder)
    of_today = opened(folder, replace(ORIGIN, id="another"))
    of_today.keep(scan(1))
    of_today.close()
    of_before.keep(scan(2))
    of_before.close()
    _, out, _ = heliocube("rollback", "-c", config, "--to", program())
    assert "with 2 records that came since" in out
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        found = connection.execute("SELECT run, number, sequence FROM scans ORDER BY sequence").fetchall()
    assert found == [(1, 0, 0), (2, 0, 1), (1, 1, 2)]


def test_an_upgrade_after_a_rollback_keeps_all_records(heliocube, config, program, upgraded):
    scans = count(upgraded, "scans")
    heliocube("rollback", "-c", config, "--to", program())
    store = opened(upgraded)
    store.keep(scan(200))
    store.close()
    assert tables(upgraded)[0] == VERSION
    assert count(upgraded, "scans") == scans + 1


def test_rollback_holds_every_tracker_that_has_no_order_of_a_person(heliocube, tmp_path, program):
    file = tmp_path / "heliocube.toml"
    file.write_text("[store]\ndirectory = 'records'\n[[tracker]]\nname = 'east'\n[[tracker]]\nname = 'west'\n")
    (tmp_path / "records" / "east").mkdir(parents=True)
    stop = {"stop": {"why": "repair", "by": "ana"}}
    (tmp_path / "records" / "east" / "operator.json").write_text(json.dumps(stop))
    code, out, _ = heliocube("rollback", "-c", file, "--to", program(VERSION))
    assert code == 0
    assert "east stays as a person has ordered" in out
    assert "west is held until 'heliocube auto --tracker west'" in out
    assert json.loads((tmp_path / "records" / "east" / "operator.json").read_text()) == stop
    hold = json.loads((tmp_path / "records" / "west" / "operator.json").read_text())["hold"]
    assert hold["by"] == "heliocube"
    assert (
        hold["why"]
        == f"the program was changed back from {release()} to 0.0.9+4f1c, and nobody has checked the tracker since"
    )


def test_rollback_holds_no_tracker_on_the_machine_of_a_cube(heliocube, program, tmp_path, monkeypatch):
    monkeypatch.setattr("daemon.commands.options.CONFIG_FOLDER", tmp_path)
    for role in ("cube", "tracker"):
        file = tmp_path / f"{role}.toml"
        file.write_text(f"[store]\ndirectory = '{role}'\n")
        code, out, _ = heliocube("rollback", "-c", file, "--to", program(VERSION))
        assert code == 0
        assert ("is held until" in out) is (tmp_path / role / "operator.json").exists() is (role == "tracker")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
def test_files_that_rollback_writes_as_root_belong_to_the_user_of_the_service(heliocube, config, program, tmp_path):
    records = tmp_path / "records"
    records.mkdir()
    os.chown(records, 65534, 65534)
    assert heliocube("rollback", "-c", config, "--to", program(VERSION))[0] == 0
    kept = [path for path in records.iterdir() if path.name.startswith("operator.")]
    assert len(kept) == 2
    assert {path.stat().st_uid for path in kept} == {65534}


def test_without_a_configured_folder_the_hold_is_written_to_the_folder_that_the_service_uses(
    heliocube, config, program, tmp_path
):
    config.write_text("[instruments]\nkind = 'real'\n")
    (tmp_path / "records").mkdir()
    code, out, _ = heliocube("rollback", "-c", config, "--to", program(VERSION))
    assert code == 0
    assert "is held until 'heliocube auto'" in out
    assert json.loads((tmp_path / "records" / "operator.json").read_text())["hold"]["by"] == "heliocube"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
@pytest.mark.parametrize(
    ("tables", "folders"), [("", ["tracker"]), ("[[tracker]]\nname = 'east'", ["east", "tracker"])]
)
def test_folders_that_rollback_makes_as_root_belong_to_the_owner_of_the_parent_folder(
    heliocube, program, tmp_path, tables, folders
):
    state = tmp_path / "state"
    state.mkdir()
    os.chown(state, 65534, 65534)
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[store]\ndirectory = 'state/tracker'\n{tables}\n")
    assert heliocube("rollback", "-c", file, "--to", program(VERSION))[0] == 0
    made = list(state.rglob("*"))
    assert sorted(path.name for path in made if path.is_dir()) == folders
    assert len([path for path in made if path.name == "operator.json"]) == 1
    assert {path.stat().st_uid for path in made} == {65534}


def test_a_release_that_does_not_tell_its_version_is_called_by_the_name_of_its_folder(
    heliocube, config, program, tmp_path
):
    (tmp_path / "records").mkdir()
    heliocube("rollback", "-c", config, "--to", program(VERSION, release="echo no module; exit 1"))
    hold = json.loads((tmp_path / "records" / "operator.json").read_text())["hold"]
    assert "to 0.0.9, and nobody" in hold["why"]


def test_without_a_copy_of_the_older_store_rollback_sets_the_store_aside_for_a_new_one(
    heliocube, config, program, upgraded
):
    copy_path(upgraded / FILE_NAME, OLDER).unlink()
    code, out, _ = heliocube("rollback", "-c", config, "--to", program())
    assert code == 0
    assert "a new one begins" in out
    assert not (upgraded / FILE_NAME).exists()
    assert len(list(upgraded.glob("heliocube.newer-*.sqlite"))) == 1


def test_rollback_can_be_repeated_after_an_interruption(heliocube, config, program, upgraded):
    scans = count(upgraded, "scans")
    shutil.copy(upgraded / FILE_NAME, upgraded / "kept")
    heliocube("rollback", "-c", config, "--to", program())
    # As a power cut leaves the files before each of the two renames.
    shutil.move(upgraded / FILE_NAME, copy_path(upgraded / FILE_NAME, OLDER))
    assert heliocube("rollback", "-c", config, "--to", program())[0] == 0
    assert (tables(upgraded)[0], count(upgraded, "scans")) == (OLDER, scans)

    shutil.move(upgraded / FILE_NAME, copy_path(upgraded / FILE_NAME, OLDER))
    shutil.move(upgraded / "kept", upgraded / FILE_NAME)
    assert heliocube("rollback", "-c", config, "--to", program())[0] == 0
    assert (tables(upgraded)[0], count(upgraded, "scans")) == (OLDER, scans)


def test_with_a_damaged_newer_store_rollback_restores_the_copy_and_says_what_is_missing(
    heliocube, config, program, upgraded
):
    path = upgraded / FILE_NAME
    content = bytearray(path.read_bytes())
    content[4096 * 2 :] = b"\xff" * (len(content) - 4096 * 2)
    path.write_bytes(content)
    code, out, _ = heliocube("rollback", "-c", config, "--to", program())
    assert code == 0
    assert "WITHOUT the records that came since" in out
    assert (tables(upgraded)[0], count(upgraded, "scans")) == (OLDER, 5)


def test_a_configuration_that_the_older_release_cannot_read_is_put_back_and_the_newer_one_is_kept(
    heliocube, config, program
):
    config.write_text("[law]\nname = 'flat' # for now\n")
    config.chmod(0o640)
    heliocube_before = config.read_text()
    heliocube("config", "migrate", "--keys-only", config)
    migrated = config.read_text() + "# mine\n"
    config.write_text(migrated)

    heliocube("rollback", "-c", config, "--to", program(VERSION))
    assert config.read_text() == migrated, "one that it can read is left as it is"

    code, out, _ = heliocube("rollback", "-c", config, "--to", program(VERSION, refuses="driver"))
    assert code == 0
    newer = config.with_name(f"{config.name}.newer-{release()}")
    assert f"your changes since then are only in {newer}" in out
    assert (config.read_text(), newer.read_text()) == (heliocube_before, migrated)
    assert config.stat().st_mode == newer.stat().st_mode == backup_path(config).stat().st_mode


def test_a_configuration_named_by_a_relative_path_or_no_worse_than_the_one_before_stays_in_place(
    heliocube, config, program, monkeypatch
):
    config.write_text("[law]\nname = 'flat'\n[site]\nlatitude_deg = 50\n")
    heliocube("config", "migrate", "--keys-only", config)
    migrated = config.read_text()

    monkeypatch.chdir(config.parent)
    code, out, _ = heliocube("rollback", "-c", config.name, "--to", program(VERSION))
    assert (code, config.read_text()) == (0, migrated)
    assert f"{config}: 0.0.9 can use it as it is" in out

    code, out, _ = heliocube("rollback", "-c", config, "--to", program(VERSION, refuses="latitude_deg"))
    assert (code, config.read_text()) == (0, migrated)
    assert f"{config} stays as it is: 0.0.9 finds mistakes in it and in {backup_path(config)}" in out


def test_an_empty_configuration_from_before_the_upgrade_is_not_put_back(heliocube, config, program):
    config.write_text("[law]\nname = 'flat'\n")
    heliocube("config", "migrate", "--keys-only", config)
    migrated = config.read_text()
    backup_path(config).write_text("")
    code, out, _ = heliocube("rollback", "-c", config, "--to", program(VERSION, refuses="driver"))
    assert (code, config.read_text()) == (0, migrated)
    assert f"{config} stays as it is" in out


def test_of_several_configurations_from_before_an_upgrade_the_latest_is_put_back(heliocube, config, program):
    for law in ("flat", "mu-prime"):
        config.write_text(f"[law]\nname = '{law}'\n")
        heliocube("config", "migrate", "--keys-only", config)
    heliocube("rollback", "-c", config, "--to", program(VERSION, refuses="driver"))
    assert config.read_text() == "[law]\nname = 'mu-prime'\n"


@pytest.mark.skipif(sys.platform != "linux", reason="what is synced is seen in /proc")
def test_the_newer_configuration_is_synced_to_disk_before_the_older_one_is_put_back(
    heliocube, config, program, synced_files
):
    for law in ("flat", "mu-prime"):
        config.write_text(f"[law]\nname = '{law}'\n")
        heliocube("config", "migrate", "--keys-only", config)
        config.chmod(0o640)
        synced_files.clear()
        heliocube("rollback", "-c", config, "--to", program(VERSION, refuses="driver"))
        (newer,) = [name for name in synced_files if ".newer-" in name]
        assert synced_files.index(newer) < synced_files.index(f".{config.name}.part")
        kept = config.with_name(newer)
        assert (kept.read_text(), kept.stat().st_mode) == (f"[law]\ndriver = '{law}'\n", config.stat().st_mode)
    assert len(list(config.parent.glob("*.newer-*"))) == 2, "what an earlier way back has kept is not overwritten"


def test_rollback_is_refused_while_a_service_uses_the_store(heliocube, config, program, upgraded):
    with lock_folder(upgraded, ("tracker",)):
        code, _, err = heliocube("rollback", "-c", config, "--to", program())
    assert code == 2
    assert "another service that runs" in err
    assert not (upgraded / "operator.json").exists()
    assert tables(upgraded)[0] == VERSION


@pytest.mark.parametrize("to", [(), ("--to", "/nowhere/bin/heliocube")])
def test_rollback_without_an_older_release_is_refused_in_one_sentence(heliocube, config, to):
    code, out, err = heliocube("rollback", "-c", config, *to)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "--to" in err


def test_rollback_is_refused_in_one_sentence_when_the_older_release_does_not_answer(
    heliocube, config, program, monkeypatch
):
    monkeypatch.setattr("daemon.commands.upgrade.installed._WITHIN_S", 0.1)
    to = program(release="exec sleep 1000")
    code, out, err = heliocube("rollback", "-c", config, "--to", to)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{to.parent / 'python'} has not answered within 0.1 s" in err
    assert "give the command again" in err
