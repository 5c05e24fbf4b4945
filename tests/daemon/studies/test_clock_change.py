"""Tables in local time: times that repeat an hour when summer time ends, and times without a zone."""

import pytest

from daemon.base.errors import UserError
from daemon.rigs.measured import read_weather
from daemon.studies.calibrate.readings import read_csv as read_faces
from daemon.studies.calibrate.readings import read_reference
from daemon.studies.compare.pairs import read_tables
from daemon.studies.recorded import read_csv

HINT = (
    "; these look like local times at the end of summer time: write UTC, or add to each time its offset, such as +01:00"
)
TABLES = [
    (read_csv, "time,east,south,west,zenith", "1,2,3,4"),
    (read_faces, "time,east_w_m2,south_w_m2,west_w_m2,zenith_w_m2", "1,2,3,4"),
    (read_reference, "time,ghi", "1"),
    (read_weather, "time,ghi,dni,dhi", "1,2,3"),
]


def refusal(tmp_path, table, times):
    read, head, row = table
    path = tmp_path / "table.csv"
    path.write_text("".join(f"{line}\n" for line in (head, *(f"{time},{row}" for time in times))))
    with pytest.raises(UserError, match=rf"{path}, line {len(times) + 1}: the time ") as refused:
        read(path)
    return str(refused.value)


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    "times",
    [
        ("2022-10-30T02:58:00", "2022-10-30T02:59:00", "2022-10-30T02:00:00"),
        ("2022-11-06 01:59:50", "2022-11-06 01:59:55", "2022-11-06 01:00:00"),
        ("2022-10-30T02:00", "2022-10-30T03:00", "2022-10-30T03:00"),
        ("2023-04-02T02:50", "2023-04-02T02:55", "2023-04-02T02:00"),
    ],
)
def test_local_times_that_repeat_an_hour_in_autumn_are_refused_with_a_hint_at_summer_time(tmp_path, table, times):
    assert refusal(tmp_path, table, times).endswith(HINT)


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize(
    "times",
    [
        ("2022-10-30T02:58:00Z", "2022-10-30T02:59:00Z", "2022-10-30T02:00:00Z"),
        ("2022-10-30T02:58:00+01:00", "2022-10-30T02:59:00+01:00", "2022-10-30T02:00:00+0100"),
        ("2022-07-30T02:58:00", "2022-07-30T02:59:00", "2022-07-30T02:00:00"),
        ("2022-10-30T12:58:00", "2022-10-30T12:59:00", "2022-10-30T12:00:00"),
        ("2022-10-30T02:58:00", "2022-10-30T02:59:00", "2022-10-30T02:58:00"),
        ("2022-10-30T02:58:00", "2022-10-30T02:59:00", "2022-10-30T02:59:00"),
        ("2022-10-30T02:58:00", "2022-10-30T02:59:00", "2022-10-30T01:00:00"),
        ("2022-10-30T02:59:00", "2022-10-30T02:00:00"),
    ],
)
def test_other_times_that_go_back_are_refused_without_a_hint_at_summer_time(tmp_path, table, times):
    assert "summer time" not in refusal(tmp_path, table, times)


@pytest.mark.parametrize(
    ("notes", "head", "row"),
    [
        (lambda path: [f"{path}: {note}" for note in read_csv(path).notes()], *TABLES[0][1:]),
        (lambda path: [read_faces(path).note], *TABLES[1][1:]),
        (lambda path: [read_reference(path).note], *TABLES[2][1:]),
        (lambda path: read_tables([path])[1], "time,tracker,pmpp_w", "east,100"),
    ],
)
def test_times_without_a_zone_are_taken_as_utc_and_that_is_reported_once(tmp_path, notes, head, row):
    path = tmp_path / "table.csv"
    path.write_text(f"{head}\n2022-03-27T01:59:55+01:00,{row}\n2022-03-27T03:00:00,{row}\n2022-03-27T03:00:05,{row}\n")
    assert notes(path) == [f"{path}: times that name no zone are taken as UTC"]
    path.write_text(f"{head}\n2022-03-27T01:59:55+01:00,{row}\n2022-03-27T01:00:00Z,{row}\n")
    assert list(filter(None, notes(path))) == []
