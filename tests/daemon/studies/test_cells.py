"""Cells of a table that are quoted or counted wrongly."""

import gzip
import re

import pytest

from daemon.base.errors import UserError
from daemon.rigs.measured import read_weather
from daemon.studies.calibrate.readings import read_csv as read_faces_in_mv
from daemon.studies.calibrate.readings import read_reference
from daemon.studies.compare.pairs import read_tables
from daemon.studies.gain.request import read_points
from daemon.studies.recorded import read_csv
from daemon.studies.sites.table import read_sites
from sim_drivers.weather import WeatherError


def weather_values(path):
    return read_weather(path).irradiance_w_m2


MARKED = "begins with a quotation mark and no mark ends it: take the mark out, or close it"
NOT_CLOSED = [
    (read_csv, "time,east,south,west,zenith,remark", "1,2,3,4,dull"),
    (read_faces_in_mv, "time,east_mv,south_mv,west_mv,zenith_mv,remark", "1,2,3,4,dull"),
    (read_reference, "time,ghi,remark", "1,dull"),
    (lambda path: read_tables([path]), "time,tracker,pmpp_w,a_deg", "cube,50,0"),
    (weather_values, "time,ghi,dni,dhi,remark", "1,2,3,dull"),
]


@pytest.mark.parametrize(("read", "head", "row"), NOT_CLOSED)
@pytest.mark.parametrize("column", [0, 1, -1])
@pytest.mark.parametrize("line", [2, 4, 60])
@pytest.mark.parametrize("packed", [False, True])
def test_a_quoted_cell_that_is_never_closed_is_refused_with_its_line_and_what_to_do(
    tmp_path, read, head, row, column, line, packed
):
    rows = [f"2022-10-14T10:{minute:02}Z,{row}" for minute in range(59)]
    cells = rows[line - 2].split(",")
    cells[column] = f'"{cells[column]}'
    rows[line - 2] = ",".join(cells)
    path = tmp_path / ("table.csv.gz" if packed else "table.csv")
    content = "\n".join([head, *rows, ""]).encode()
    path.write_bytes(gzip.compress(content) if packed else content)
    with pytest.raises(UserError, match=rf"{path}, line {line}: a cell {MARKED}$"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), NOT_CLOSED)
def test_a_quotation_mark_that_swallows_more_than_a_cell_may_hold_is_refused_with_its_line(tmp_path, read, head, row):
    path = tmp_path / "table.csv"
    rows = [f"2022-10-14T{hour:02}:{minute:02}:{second:02}Z,{row}" for hour in range(2) for minute in range(60)
            for second in range(60)]  # fmt: skip
    path.write_text("\n".join([head, rows[0], f'"{rows[1]}', *rows[2:], ""]))
    with pytest.raises(UserError, match=rf"{path}, line 3: a cell {MARKED}$"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), NOT_CLOSED[1:])
def test_a_line_with_a_cell_too_many_is_refused_with_its_line_number(tmp_path, read, head, row):
    path = tmp_path / "table.csv"
    path.write_text(f"{head}\n2022-10-14T10:00Z,{row}\n2022-10-14T10:01Z,{row},5\n")
    counts = rf"{head.count(',') + 2} cells where the header has {head.count(',') + 1}"
    with pytest.raises(UserError, match=rf"{path}, line 3: there are {counts}$"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), [*NOT_CLOSED[:3], NOT_CLOSED[4]])
def test_a_remark_of_two_lines_is_read(tmp_path, read, head, row):
    path = tmp_path / "table.csv"

    def found_with(remark):
        first = row.replace("dull", remark)
        path.write_text(f"{head}\n2022-10-14T10:00Z,{first}\n2022-10-14T10:01Z,{row}\n")
        return repr(read(path))

    assert found_with('"dull,\nand ""cold"""') == found_with("dull")


def notes_of_weather(path):
    return [read_weather(path).note()]


def times_of_weather(path):
    return read_weather(path).utc_s


LOGGED = [
    (lambda path: len(read_csv(path).rows), lambda path: read_csv(path).notes(), *NOT_CLOSED[0][1:]),
    (lambda path: len(read_faces_in_mv(path).utc_s), lambda path: [read_faces_in_mv(path).note], *NOT_CLOSED[1][1:]),
    (lambda path: len(read_reference(path).utc_s), lambda path: [read_reference(path).note], *NOT_CLOSED[2][1:]),
    (lambda path: len(read_tables([path])[0]), lambda path: read_tables([path])[1], *NOT_CLOSED[3][1:]),
    (lambda path: len(times_of_weather(path)), notes_of_weather, *NOT_CLOSED[4][1:]),
]


def logged(folder, packed, *lines):
    path = folder / ("table.csv.gz" if packed else "table.csv")
    content = "\n".join(lines).encode()
    path.write_bytes(gzip.compress(content) if packed else content)
    return path


@pytest.mark.parametrize(("count", "notes", "head", "row"), LOGGED)
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("cut", ["2022-1", "2022-10-14T10:02Z,", "2022-10-14T10:02Z,-"])
def test_a_last_line_that_a_logger_has_not_finished_is_left_out_and_reported(
    tmp_path, count, notes, head, row, packed, cut
):
    lines = [head, f"2022-10-14T10:00Z,{row}", "", f"2022-10-14T10:01Z,{row}"]
    path = logged(tmp_path, packed, *lines, cut)
    assert count(path) == 2
    (note,) = notes(path)
    cells, due = cut.count(",") + 1, head.count(",") + 1
    assert note.endswith(f"the last line, 5, breaks off at cell {cells} of {due} and is left out")


@pytest.mark.parametrize(("count", "notes", "head", "row"), LOGGED)
def test_a_last_line_with_all_its_cells_is_read_even_without_an_end_of_line(tmp_path, count, notes, head, row):
    path = logged(tmp_path, False, head, f"2022-10-14T10:00Z,{row}", f"2022-10-14T10:01Z,{row}")
    assert count(path) == 2
    assert not any(notes(path))


NUMBERED = [
    (count, notes, head.removesuffix(",remark"), row.removesuffix(",dull").rpartition(",")[0])
    for count, notes, head, row in LOGGED
]


def with_last_number(folder, head, row, above, last):
    """A file whose last column has these numbers, and whose last line has no end."""
    cells = [row] * bool(row)
    times = (f"2022-10-14T10:{minute:02}Z" for minute in range(60))
    return logged(
        folder,
        False,
        head,
        *(",".join([at, *cells, number]) for at, number in zip(times, [*above, last], strict=False)),
    )


@pytest.mark.parametrize(("count", "notes", "head", "row"), NUMBERED)
@pytest.mark.parametrize("last", ["-", "1", "12."])
def test_a_last_line_whose_number_has_fewer_decimals_than_all_above_it_is_left_out_as_broken_off(
    tmp_path, count, notes, head, row, last
):
    path = with_last_number(tmp_path, head, row, ["1.5", *["12.25"] * 30], last)
    assert count(path) == 31
    (note,) = notes(path)
    due = head.count(",") + 1
    assert note.endswith(f"the last line, 33, breaks off at cell {due} of {due} and is left out")


@pytest.mark.parametrize(("count", "notes", "head", "row"), NUMBERED)
@pytest.mark.parametrize(("above", "last"), [(["1.5"] * 30, "1.2"), (["1.5"] * 30 + ["2"], "1"), (["1.5"] * 29, "1")])
def test_a_last_line_whose_last_number_may_be_complete_is_read(tmp_path, count, notes, head, row, above, last):
    path = with_last_number(tmp_path, head, row, above, last)
    assert count(path) == len(above) + 1
    assert not any(notes(path))


@pytest.mark.parametrize(("count", "notes", "head", "row"), LOGGED)
@pytest.mark.parametrize("blank", ["   ", "\t", ",,"])
def test_blanks_after_the_last_line_are_not_reported_as_a_line_that_breaks_off(
    tmp_path, count, notes, head, row, blank
):
    path = logged(tmp_path, False, head, f"2022-10-14T10:00Z,{row}", f"2022-10-14T10:01Z,{row}", blank)
    assert count(path) == 2
    assert not any(notes(path))


@pytest.mark.parametrize(("count", "notes", "head", "row"), [*LOGGED[:3], LOGGED[4]])
def test_a_last_line_with_a_quoted_remark_of_two_lines_is_read_even_without_an_end_of_line(
    tmp_path, count, notes, head, row
):
    last = row.replace("dull", '"dull,\nand cold"')
    path = logged(tmp_path, False, head, f"2022-10-14T10:00Z,{row}", f"2022-10-14T10:01Z,{last}")
    assert count(path) == 2
    assert not any(notes(path))


PACKED = [
    *[(read, head, f"2022-10-14T10:00Z,{row}") for read, head, row in NOT_CLOSED],
    (lambda path: read_sites(path, "clear"), "name,latitude,longitude", "Lyngby,55.79,12.53"),
    (read_points, "phi_deg,beta_deg,n,lambda_deg", "48,30,172,0"),
]


@pytest.mark.parametrize(("read", "head", "row"), PACKED)
@pytest.mark.parametrize("spoil", [lambda whole: whole[:-9], lambda whole: whole[:-8] + bytes(8)])
def test_a_packed_table_that_is_cut_off_or_damaged_is_refused_with_what_to_do(tmp_path, read, head, row, spoil):
    path = tmp_path / "table.csv.gz"
    path.write_bytes(spoil(gzip.compress(f"{head}\n{row}\n".encode())))
    what = f"{path} cannot be read: it is cut off or damaged; copy it anew, or unpack what is left: zcat FILE > NEW.csv"
    with pytest.raises((UserError, WeatherError), match=rf"{re.escape(what)}$"):
        read(path)
