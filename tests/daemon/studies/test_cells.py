"""Cells of a table that are quoted or counted wrongly."""

import gzip

import pytest

from daemon.base.errors import UserError
from daemon.rigs.measured import measured_weather
from daemon.studies.calibrate.readings import read_csv as read_faces_in_mv
from daemon.studies.calibrate.readings import read_reference
from daemon.studies.compare.pairs import read_tables
from daemon.studies.recorded import read_csv


def weather_values(path):
    return measured_weather(path).irradiance_w_m2


MARKED = "begins with a quotation mark and none ends it: take the mark out, or close it"
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
def test_a_mark_that_swallows_more_than_a_cell_may_hold_is_found_as_well(tmp_path, read, head, row):
    path = tmp_path / "table.csv"
    rows = [f"2022-10-14T{hour:02}:{minute:02}:{second:02}Z,{row}" for hour in range(2) for minute in range(60)
            for second in range(60)]  # fmt: skip
    path.write_text("\n".join([head, rows[0], f'"{rows[1]}', *rows[2:], ""]))
    with pytest.raises(UserError, match=rf"{path}, line 3: a cell {MARKED}$"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), NOT_CLOSED[1:])
def test_a_line_with_a_cell_too_many_is_named(tmp_path, read, head, row):
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
