"""Pages of a store's records: what goes in comes out, and anything else is refused in one sentence."""

import json
import math
import sqlite3
from contextlib import closing

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.base.clock import SystemClock
from daemon.base.records import Event, Pose
from daemon.store.batches import KINDS, BatchError, decoded, encoded, next_batch, with_identifier
from daemon.store.runs import runs_of
from daemon.store.schema import FILE_NAME, open_for_reading
from daemon.store.store import Store
from tests.support.archive import T0, batch_of, origin, pose, pose_row, scan

GOOD = json.loads(encoded(batch_of(origin(), {"poses": [pose_row(0), pose_row(1)]})))


@pytest.fixture
def kept(tmp_path):
    def keep(*records, run=None):
        store = Store(tmp_path, 60.0, 400, run or origin(), SystemClock(), print)
        for record in records:
            store.keep(record)
        store.close()
        return tmp_path / FILE_NAME

    return keep


def pages(path, most=500):
    with closing(open_for_reading(path)) as connection:
        for run, known in runs_of(path):
            after = -1
            while batch := next_batch(connection, run, known, after, most):
                yield batch
                after = batch.through


def test_every_record_of_every_run_is_in_exactly_one_page_and_decodes_unchanged(kept):
    kept(*(pose(n) for n in range(5)), scan(1), Event(T0, 0.0, "a", "ü\n"), run=origin(tracker="first"))
    path = kept(*(pose(n, T0 + 0.1234567) for n in range(3)))
    found = list(pages(path, most=3))
    assert [(batch.origin.tracker, batch.through, batch.count) for batch in found] == [
        ("first", 2, 3),
        ("first", 5, 3),
        ("first", 6, 1),
        ("roof", 2, 3),
    ]
    again = [decoded(encoded(batch)) for batch in found]
    assert [batch.origin for batch in again] == [batch.origin for batch in found]
    assert again[3].rows["poses"][0] == (0, T0 + 0.1234567, 0.0, -45.0, 0.0, False, "", None)
    assert again[2].rows["events"][0][-2:] == ("ü\n", "")
    assert again[1].rows["scans"][0][5:7] == (1, True)


@pytest.mark.parametrize("tables_read", range(1, 1 + len(KINDS)))
def test_records_written_while_a_page_is_read_are_not_missed(kept, tables_read):
    path = kept(pose(0))
    with closing(open_for_reading(path)) as connection, closing(sqlite3.connect(path)) as service:
        ((run, known),) = runs_of(path)
        seen = []

        def read(statement):
            if statement.startswith("SELECT number"):
                seen.append(statement)
                if len(seen) == tables_read:
                    for kind, number in (("poses", 1), ("events", 2)):
                        columns = [row[1] for row in service.execute(f"PRAGMA table_info({kind})")]
                        values = [run, number, T0, *["1"] * (len(columns) - 3)]
                        service.execute(f"INSERT INTO {kind} VALUES ({', '.join('?' * len(columns))})", values)
                    service.commit()

        connection.set_trace_callback(read)
        first = next_batch(connection, run, known, -1)
        second = next_batch(connection, run, known, first.through)
    numbers = [row[0] for batch in (first, second) if batch for rows in batch.rows.values() for row in rows]
    assert sorted(numbers) == [0, 1, 2]


def test_an_old_run_without_an_identifier_always_gets_the_same_one_and_no_other_run_has_it(kept):
    path = kept(Pose(T0, 0.0, 1.0, 2.0, moving=True), run=origin(id=""))
    kept(Pose(T0, 0.0, 1.0, 2.0, moving=True), run=origin(id=""))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("ALTER TABLE runs DROP COLUMN id")
        connection.execute("PRAGMA user_version = 7")
    first = [with_identifier(*found).id for found in runs_of(path)]
    kept(run=origin())
    assert [with_identifier(*found).id for found in runs_of(path)] == first
    assert len(set(first)) == 2


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"format": 2}, "it is of format 2, and this archive reads format 1: update the archive"),
        ({"run": {**GOOD["run"], "id": ""}}, "its run has no identifier"),
        ({"run": {**GOOD["run"], "id": "'; DROP TABLE runs; --"}}, "its run has no identifier"),
        ({"run": {**GOOD["run"], "latitude_deg": None}}, "its run has no place or no start"),
        ({"through": 0}, "it has records after its own end"),
        ({"through": -1}, "is not the number of a record"),
        ({"records": {"poses": {"columns": ["number", "time"], "rows": [[0, 1e10]]}}}, "no time from 1970 to 2200"),
        ({"records": {"poses": {"columns": ["number", "time"], "rows": [[0, "now"]]}}}, "'now' is no number"),
        ({"records": {"poses": {"columns": ["number"], "rows": [[0]]}}}, "no time from 1970 to 2200"),
        ({"records": {"poses": {"rows": []}}}, "it is no page of records"),
        ({"records": []}, "it is no page of records"),
        ({"records": {"poses": {"columns": ["number", "time"], "rows": [[0]]}}}, "it is no page of records"),
        (
            {"records": {"poses": {"columns": ["number", "time"], "rows": [[0, 10**400]]}}},
            "it is no page of records",
        ),
        (
            {"records": {"poses": {"columns": ["number", "time"], "rows": [], "\ud800": 0}}},
            "it is no page of records",
        ),
        ({"run": {**GOOD["run"], "altitude_m": 10**400}}, "it is no page of records"),
        ({"run": {**GOOD["run"], "started_utc_s": 1e18}}, "its run has no place or no start"),
        ({"run": {**GOOD["run"], "started_utc_s": -1}}, "its run has no place or no start"),
        ({"run": {**GOOD["run"], "site": "\ud800"}}, "it is no page of records"),
        ({"records": {"poses": {"columns": ["number", "time"], "rows": [[0, T0]] * 5001}}}, "5000 are the most"),
        (
            {"records": {**GOOD["records"], "b\u00e4ume": {"columns": ["number", "time"], "rows": [[1, T0]]}}},
            "it has 'b\\xe4ume', which this archive does not know: update the archive",
        ),
        (
            {"records": {"poses": {"columns": ["number", "time", "c_deg"], "rows": [[0, T0, None], [1, T0, 5.0]]}}},
            "it has poses with 'c_deg', which this archive does not know: update the archive",
        ),
    ],
)
def test_a_message_that_is_no_valid_page_of_records_is_refused_with_the_reason(change, part):
    with pytest.raises(BatchError) as error:
        decoded(json.dumps(GOOD | change).encode())
    assert part in str(error.value)
    assert str(error.value).isascii()


def test_columns_may_come_in_any_order_and_those_of_another_version_without_a_value_are_left_out():
    table = {"columns": ["new", "b_deg", "time", "number"], "rows": [[None, 60, T0, 0]]}
    batch = decoded(json.dumps(GOOD | {"records": {"poses": table}}).encode())
    assert batch.rows == {"poses": [(0, T0, None, None, 60.0, None, None, None)]}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(math.inf),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from([*GOOD, "poses", "rows"]), inner),
    max_leaves=12,
)


@settings(max_examples=40)
@given(st.sampled_from([*GOOD]), JSON)
def test_any_message_is_either_decoded_or_refused_in_a_single_line(key, value):
    for payload in (json.dumps(GOOD | {key: value}), json.dumps(value)):
        try:
            decoded(payload.encode())
        except BatchError as error:
            refused = str(error)
        else:
            refused = ""
        assert "\n" not in refused
