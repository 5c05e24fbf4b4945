"""Whatever is left of a damaged store comes back unchanged, and the damaged file stays as it is."""

import json
import os
import random
import re
import shutil
import sqlite3
import stat
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from hashlib import sha256

import pytest

from daemon.base.clock import SystemClock
from daemon.base.records import Pose
from daemon.commands.main import main
from daemon.store.salvage import salvage
from daemon.store.schema import FILE_NAME, VERSION, open_for_reading
from daemon.store.store import Store
from tests.daemon.store.test_store import ORIGIN, keep
from tests.daemon.store.test_tables import ALL, T0, decision, scan

pytestmark = pytest.mark.slow

__all__ = ["keep"]
PAGE = 4096
SCANS, POSES = 8000, 4000


def table(folder, name):
    with closing(open_for_reading(folder / FILE_NAME)) as connection:
        return set(connection.execute(f"SELECT * FROM {name}").fetchall())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A store of two runs."""
    folder = tmp_path_factory.mktemp("whole")
    for run in range(2):
        store = Store(folder, 60.0, 400, replace(ORIGIN, started_utc_s=T0 + run), SystemClock(), lambda event: None)
        for n in range(SCANS // 2):
            store.keep(replace(scan(n), session=str(run)))
            if n % 2 == 0:
                store.keep(Pose(T0 + n, float(n), 1.5, 60.0, moving=False))
        store.keep(decision())
        store.close()
    return folder


def digest(folder):
    return {one.name: sha256(one.read_bytes()).hexdigest() for one in folder.iterdir()}


def damaged(whole, tmp_path, spoil):
    folder = tmp_path / "damaged"
    shutil.copytree(whole, folder)
    path = folder / FILE_NAME
    content = bytearray(path.read_bytes())
    path.write_bytes(spoil(content, random.Random(len(content))))
    return path


def pages(count):
    def spoil(content, rng):
        for number in rng.sample(range(2, len(content) // PAGE), count):
            content[number * PAGE : (number + 1) * PAGE] = rng.randbytes(PAGE)
        return content

    return spoil


def zeroed(content, rng):
    # Only pages after the roots: a lost root costs its whole table, as decision 25 says.
    number = rng.randrange(32, len(content) // PAGE)
    content[number * PAGE : (number + 8) * PAGE] = bytes(8 * PAGE)
    return content[: len(content) // PAGE * PAGE]


def half(content, _rng):
    return content[: len(content) // 2 + 1234]


def without_first_page(content, rng):
    return rng.randbytes(PAGE) + content[PAGE:]


def without_header(content, _rng):
    return bytes(100) + content[100:]


@pytest.mark.parametrize(
    ("spoil", "at_least"),
    [
        (pages(1), 0.97),
        (pages(10), 0.6),
        (zeroed, 0.9),
        (half, 0.3),
        (without_first_page, 1.0),
        (without_header, 1.0),
    ],
)
def test_readable_records_of_a_damaged_store_are_salvaged_unchanged_and_none_is_invented(
    whole, tmp_path, spoil, at_least
):
    path = damaged(whole, tmp_path, spoil)
    before = digest(path.parent)
    found = salvage(path, tmp_path / "new")
    assert digest(path.parent) == before
    assert found.read == found.added
    scans, true = table(tmp_path / "new", "scans"), table(whole, "scans")
    assert len(scans) >= at_least * SCANS
    # A run gets a new number; all else is as it was.
    assert {row[1:] for row in scans} <= {row[1:] for row in true}
    poses = table(tmp_path / "new", "poses")
    assert len(poses) >= at_least * POSES * 0.9
    assert {row[1:] for row in poses} <= {row[1:] for row in table(whole, "poses")}
    again = salvage(path, tmp_path / "new")
    assert sum(again.added.values()) == 0
    assert table(tmp_path / "new", "scans") == scans
    assert not list((tmp_path / "new").glob(".salvage*"))


def test_an_undamaged_store_is_salvaged_whole_and_merged_with_the_later_records(keep, tmp_path):
    first = keep(*ALL, folder=tmp_path / "first")
    later = keep(replace(decision(), time_utc_s=T0 + 60), folder=tmp_path / "later")
    found = salvage(first / FILE_NAME, later)
    assert (found.damaged, found.missing) == (False, 0)
    assert found.added == {"scans": 2, "decisions": 2, "moves": 1, "poses": 1, "modes": 1, "events": 1, "curves": 1}
    assert len(table(later, "decisions")) == 3
    assert len(table(later, "runs")) == 1, "they are of the same start of the service"
    assert table(later, "days") == table(first, "days")


def test_a_salvage_reports_how_much_it_has_read_while_it_works(keep, tmp_path):
    folder, shares = keep(*[scan(number) for number in range(3500)]), []
    salvage(folder / FILE_NAME, tmp_path / "new", shares.append)
    assert shares == pytest.approx([1 / 3.5, 2 / 3.5, 3 / 3.5])


def test_records_in_the_write_ahead_log_beside_the_store_are_salvaged(keep, tmp_path):
    folder = keep(scan(0))
    path = folder / FILE_NAME
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA wal_autocheckpoint = 0")
        connection.execute("UPDATE scans SET sequence = 77")
        shutil.copytree(folder, tmp_path / "crashed")
    assert (tmp_path / "crashed" / f"{FILE_NAME}-wal").stat().st_size > 0
    salvage(tmp_path / "crashed" / FILE_NAME, tmp_path / "new")
    with closing(open_for_reading(tmp_path / "new" / FILE_NAME)) as connection:
        assert connection.execute("SELECT sequence FROM scans").fetchall() == [(77,)]


def test_a_row_with_a_single_value_of_the_wrong_type_is_left_out_of_a_salvage(keep, tmp_path):
    path = keep(scan(0), scan(1)) / FILE_NAME
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE scans SET south_w_m2 = 'rubbish' WHERE number = (SELECT min(number) FROM scans)")
    assert salvage(path, tmp_path / "new").added["scans"] == 1


def test_a_folder_in_the_place_of_the_write_ahead_log_does_not_prevent_a_salvage(keep, tmp_path):
    path = keep(scan(0)) / FILE_NAME
    path.with_name(f"{FILE_NAME}-wal").mkdir()
    assert salvage(path, tmp_path / "new").added["scans"] == 1


def test_a_store_of_a_newer_version_is_salvaged_as_far_as_this_version_knows_it(keep, tmp_path):
    folder = keep(*ALL)
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("ALTER TABLE scans ADD COLUMN humidity REAL")
        connection.execute("CREATE TABLE rain (run INTEGER, number INTEGER)")
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    found = salvage(folder / FILE_NAME, tmp_path / "new")
    assert sum(found.added.values()) == len(ALL)
    with closing(sqlite3.connect(tmp_path / "new" / FILE_NAME)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (VERSION,)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to others")
@pytest.mark.parametrize("folder", ["", "tracker"])
def test_a_store_that_root_salvages_into_belongs_to_the_owner_of_the_folder(keep, tmp_path, folder):
    keep(*ALL, folder=tmp_path / "old")
    state = tmp_path / "state"
    state.mkdir()
    os.chown(state, 65534, 65534)
    salvage(tmp_path / "old" / FILE_NAME, state / folder)
    assert {path.stat().st_uid for path in (state / folder, *(state / folder).iterdir())} == {65534}
    assert stat.S_IMODE((state / folder / FILE_NAME).stat().st_mode) == 0o600


def test_the_sqlite3_program_finds_a_salvaged_store_intact(whole, tmp_path):
    if shutil.which("sqlite3") is None:
        pytest.skip("sqlite3 is not installed")
    salvage(damaged(whole, tmp_path, pages(10)), tmp_path / "new")
    asked = "PRAGMA integrity_check; SELECT count(*) > 1000 FROM scans;"
    found = subprocess.run(["sqlite3", tmp_path / "new" / FILE_NAME, asked], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["ok", "1"]


def test_the_salvage_command_reports_what_it_read_and_refuses_wrong_arguments_in_one_sentence(
    whole, tmp_path, monkeypatch, capsys
):
    def heliocube(*arguments):
        monkeypatch.setattr(sys, "argv", ["heliocube", "store", "salvage", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        written = capsys.readouterr()
        return ended.value.code, written.out, written.err

    path = damaged(whole, tmp_path, pages(3))
    code, out, err = heliocube(path, "--into", tmp_path / "new")
    assert (code, err) == (0, "")
    assert re.match(
        rf"{re.escape(str(path))} is damaged: \d+ scans, 2 decisions, .* of them are new in .*new\n\d+ records", out
    )
    page = json.loads(heliocube(path, "--into", tmp_path / "new", "--json")[1])
    assert (page["damaged"], page["simulated"]) == (True, True)
    assert not any(page["added"].values()), "all of it is there already"
    notes = tmp_path / "notes"
    notes.write_text("my notes")
    for arguments, sentence in (
        ((notes, "--into", tmp_path / "new2"), f"nothing of a store can be read from {notes}"),
        (
            (tmp_path / "no", "--into", tmp_path / "new2"),
            f"there is no file {tmp_path / 'no'} to salvage: name a store",
        ),
        ((path, "--into", path.parent), f"{path} is the store of {path.parent} itself: name another folder"),
        ((path, "--into", notes / "x"), f"{notes / 'x'} cannot take the records and a copy of {path}: Not"),
    ):
        code, out, err = heliocube(*arguments)
        assert (code, out) == (2, "")
        assert err.startswith(f"heliocube: {sentence}")
        assert err.count("\n") == 1
    assert not (tmp_path / "new2").exists(), "no folder is left in which nothing came"
