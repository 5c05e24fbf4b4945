"""Files that people give to the studies and commands."""

import gzip
import re
import tracemalloc

import pandas as pd
import pytest

from daemon.base.errors import UserError
from daemon.rigs.measured import read_weather
from daemon.studies.calibrate.readings import read_csv as read_faces_in_mv
from daemon.studies.calibrate.readings import read_reference
from daemon.studies.compare.pairs import read_tables
from daemon.studies.gain.request import read_points
from daemon.studies.inputs import check_weather_file
from daemon.studies.recorded import read_csv
from daemon.studies.sites.table import read_sites


def weather_values(path):
    return read_weather(path).irradiance_w_m2


READERS = [
    check_weather_file,
    read_csv,
    read_points,
    read_reference,
    lambda path: read_sites(path, None),
    lambda path: read_tables([path]),
]


TABLES = [
    (read_csv, "time,east,south,west,zenith", "2022-10-14T10:00Z,1,2,3,4"),
    (read_faces_in_mv, "time,east_mv,south_mv,west_mv,zenith_mv", "2022-10-14T10:00Z,1,2,3,4"),
    (read_points, "phi_deg,beta_deg,n,lambda_deg", "48,30,100,0"),
    (read_reference, "time,ghi", "2022-10-14T10:00Z,1"),
    (lambda path: read_sites(path, None), "name,latitude,longitude,weather", "here,48,2,clear"),
    (lambda path: read_tables([path]), "time,tracker,pmpp_w", "2022-10-14T10:00Z,cube,50"),
]
WEATHER = (weather_values, "time,ghi,dni,dhi", "2022-10-14T10:00Z,1,2,3")


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("ending", ["csv.xz", "csv.ZIP", "tar.gz", "csv.zst"])
def test_a_table_that_is_packed_otherwise_than_with_gzip_is_refused_with_what_to_do(tmp_path, read, ending):
    path = tmp_path / f"table.{ending}"
    path.write_bytes(b"damaged")
    with pytest.raises(UserError) as refused:
        read(path)
    remedy = "is packed in a way that cannot be read: unpack it, or pack the table alone with gzip (.gz)"
    assert str(refused.value) == f"{path} {remedy}"


@pytest.mark.timeout(60)
@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("columns", ["time", "\ufefftime" + ",1" * 1_000_000])
@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_a_line_of_a_million_columns_is_refused_at_once(tmp_path, read, columns, ending):
    path = tmp_path / f"table{ending}"
    content = f"{columns}\n2022-10-14T10:00Z{',1' * 1_000_000}\n".encode()
    path.write_bytes(gzip.compress(content, 1) if ending == ".csv.gz" else content)
    with pytest.raises(UserError, match=rf"{path}, line [12] is longer than 20000 characters: name a table with one"):
        read(path)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("time\tghi\n2022-10-14T10:00Z\t500.5\n".encode("utf-16"), "UTF-16: save it as a CSV file in UTF-8"),
        (b"PAR1\x15\x04", "a Parquet file: a CSV file is needed, the names of its columns in the first line"),
        (b"PK\x03\x04\x14\0", "a spreadsheet or packed: a CSV file is needed"),
        (gzip.compress(b"time,ghi\n", mtime=0), "packed and its name does not end in .gz: a CSV file is needed"),
        (
            b"# My station, 2022\ntime,name,ghi\n",
            "a remark: a CSV file is needed, the names of its columns in the first",
        ),
        (b"\xef\xbb\xbfsep=,\ntime,name,ghi\n", "'sep=': a CSV file is needed"),
    ],
)
def test_a_table_of_a_spreadsheet_that_is_no_csv_is_refused_with_how_to_save_it(tmp_path, read, content, sentence):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(UserError, match=rf"^{path} (has|is text in|is|begins with) {sentence}"):
        read(path)


@pytest.mark.parametrize("read", READERS)
def test_a_table_that_has_been_unpacked_under_its_old_name_is_refused_with_what_to_do(tmp_path, read):
    path = tmp_path / "table.CSV.GZ"
    path.write_text("time,name,ghi\n2022-10-14T10:00Z,here,1\n")
    with pytest.raises(UserError, match=rf"^{path} is not packed with gzip, though its name ends in \.gz: take the "):
        read(path)


@pytest.mark.parametrize("read", [read_weather, read_reference, lambda path: read_tables([path])])
@pytest.mark.parametrize("wrong", ["now", "today", "0001-01-01T00:00+05:00", "1066-10-14", "2300-01-01", "NaT"])
def test_a_word_or_a_year_long_past_or_far_ahead_is_refused_as_a_time(tmp_path, read, wrong):
    path = tmp_path / "table.csv"
    head = "time,tracker,pmpp_w,ghi_w_m2" if "lambda" in read.__name__ else "time,dni,dhi,ghi"
    path.write_text(f"{head}\n{wrong},1,2,3\n")
    with pytest.raises(UserError, match=rf"{path}, (line 2|row 1): '{re.escape(wrong)}' is not a time"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), TABLES)
def test_rows_of_empty_cells_as_a_spreadsheet_leaves_them_are_passed_over(tmp_path, read, head, row):
    plain, padded = tmp_path / "plain.csv", tmp_path / "padded.csv"
    empty = "," * head.count(",")
    plain.write_text(f"{head}\n{row}\n")
    padded.write_text(f"{head}\n{empty}\n{row}\n{empty}\n{empty}\n")
    assert str(read(padded)).replace("padded", "plain") == str(read(plain))


def test_the_line_number_of_a_mistake_counts_rows_of_empty_cells_before_it(tmp_path):
    path = tmp_path / "reference.csv"
    path.write_text("time,ghi\n,\n\n2022-10-14T10:00Z,1\n2022-10-14T10:01Z,cloudy\n")
    with pytest.raises(UserError, match=rf"{path}, line 5: ghi is 'cloudy'"):
        read_reference(path)


def test_powers_may_have_blanks_around_their_commas_and_a_comma_at_the_end(tmp_path):
    path = tmp_path / "powers.csv"
    path.write_text("time , tracker, pmpp_w,\n2022-10-14T10:00Z , cube , 50,\n")
    powers, _ = read_tables([path])
    assert powers[["tracker", "pmpp_w"]].to_numpy().tolist() == [["cube", 50.0]]


@pytest.mark.parametrize("again", ["tracker", "tracker "])
def test_powers_with_a_column_twice_are_refused(tmp_path, again):
    path = tmp_path / "powers.csv"
    path.write_text(f"time,tracker,pmpp_w,{again}\n2022-10-14T10:00Z,cube,50,chrono\n")
    with pytest.raises(UserError, match=rf"{path} has two columns tracker: keep only the right one"):
        read_tables([path])


@pytest.mark.parametrize("read", [read_weather, read_reference, lambda path: read_tables([path])])
def test_lines_with_a_cell_more_than_the_header_are_refused(tmp_path, read):
    path = tmp_path / "table.csv"
    path.write_text("time,dni,dhi,ghi\n2022-10-14T10:00Z,1,2,3,\n2022-10-14T10:01Z,1,2,3,\n")
    with pytest.raises(UserError, match=rf"{path} has more cells in its lines than names in its header"):
        read(path)


def test_powers_in_parquet_are_read_whatever_the_case_of_their_ending(tmp_path):
    path = tmp_path / "powers.PARQUET"
    pd.DataFrame({"time": ["2022-10-14T10:00Z"], "tracker": "cube", "pmpp_w": 50.0}).to_parquet(path)
    powers, _ = read_tables([path])
    assert powers[["tracker", "pmpp_w"]].to_numpy().tolist() == [["cube", 50.0]]


@pytest.mark.parametrize("read", [read_weather, *READERS[1:]])
def test_a_table_in_another_encoding_than_utf_8_is_refused_with_what_to_do(tmp_path, read):
    path = tmp_path / "table.csv"
    path.write_bytes("time,name,ghi,Température °C\n2022-10-14T10:00Z,here,1,20\n".encode("latin-1"))
    with pytest.raises(UserError, match=rf"{path} .*is not text in UTF-8: save it as such"):
        read(path)


def test_column_names_and_cells_of_a_weather_file_may_be_quoted_after_blanks(tmp_path):
    path = tmp_path / "weather.csv"
    path.write_text('"time", "ghi", "dni", "dhi"\n"2022-10-14T10:00Z", "1", "2", "3"\n')
    assert read_weather(path).irradiance_w_m2["dhi"].tolist() == [3.0]


@pytest.mark.parametrize(("read", "head", "row"), TABLES)
def test_names_of_columns_may_be_in_capitals_and_cells_quoted_after_blanks(tmp_path, read, head, row):
    plain, quoted = tmp_path / "plain.csv", tmp_path / "quoted.csv"
    plain.write_text(f"{head}\n{row}\n")
    quoted.write_text(
        "".join(", ".join(f'"{cell}"' for cell in line.split(",")) + "\n" for line in (head.upper(), row))
    )
    assert str(read(quoted)).replace("quoted", "plain") == str(read(plain))


@pytest.mark.parametrize(("read", "head", "row"), TABLES)
def test_a_column_twice_is_refused_in_every_table(tmp_path, read, head, row):
    path = tmp_path / "table.csv"
    name = head.split(",")[1]
    path.write_text(f"{head},{name}\n{row},1\n")
    with pytest.raises(UserError, match=rf"{path}.* two columns {name}: keep only the right one"):
        read(path)


@pytest.mark.parametrize(("read", "head", "row"), [*TABLES, WEATHER])
def test_semicolons_with_decimal_commas_and_tabs_are_read_as_a_spreadsheet_writes_them(tmp_path, read, head, row):
    plain, semicolons, tabs = tmp_path / "plain.csv", tmp_path / "semicolons.csv", tmp_path / "tabs.csv"
    text = f"{head}\n{row.replace(',2', ',2.5').replace(',50', ',50.5').replace('30', '30.5')}\n"
    plain.write_text(text)
    semicolons.write_text("\ufeff" + text.replace(",", ";").replace(".", ",").replace("\n", "\r\n"), encoding="utf-8")
    tabs.write_text(text.replace(",", "\t"))
    for path in (semicolons, tabs):
        assert str(read(path)).replace(path.name, plain.name) == str(read(plain))


def test_a_comma_between_thousands_is_not_read_as_a_decimal_comma(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("time\tghi\n2022-10-14T10:00Z\t1,234\n")
    with pytest.raises(UserError, match=rf"{path}, line 2: ghi is '1,234', not a number"):
        read_reference(path)


@pytest.mark.parametrize("missing", ["NaN", "NA", "N/A", "null", " NA "])
def test_the_words_of_various_programs_for_a_missing_value_are_read_as_missing(tmp_path, missing):
    path = tmp_path / "table.csv"
    path.write_text(f"time,ghi,dni,dhi\n2022-10-14T10:00Z,{missing},2,3\n2022-10-14T10:01Z,1,2,3\n")
    assert weather_values(path)["ghi"].tolist() == read_reference(path).ghi_w_m2.tolist() == [1.0]
    path.write_text(f"time,east,south,west,zenith\n2022-10-14T10:00Z,1,{missing},3,4\n")
    assert read_csv(path).missing == 1
    path.write_text(f"time,tracker,pmpp_w,ghi_w_m2\n2022-10-14T10:00Z,cube,50,{missing.strip()}\n")
    assert read_tables([path])[0]["ghi_w_m2"].isna().all()


@pytest.mark.parametrize(("read", "head", "row"), [*TABLES, WEATHER])
@pytest.mark.parametrize("text", ["1_0", "\uff11\uff10"])
def test_a_number_in_a_form_that_only_python_accepts_is_refused_with_its_place(tmp_path, read, head, row, text):
    path = tmp_path / "table.csv"
    for number in (",2", ",50", ",30", "Z,1"):
        row = row.replace(number, f"{number[:-1]}{text}")
    path.write_text(f"{head}\n{row}\n")
    with pytest.raises(UserError, match=rf"{path},? (line 2|row 1): .*{text}"):
        read(path)


def test_inf_from_a_logger_beyond_its_range_is_reported_as_an_impossible_reading_or_irradiance(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("time,east,south,west,zenith\n2022-10-14T10:00Z,1,INF,3,-INF\n")
    assert read_csv(path).first_impossible == "line 2: south INF"
    path.write_text("time,ghi,dni,dhi\n2022-10-14T10:00Z,INF,2,3\n2022-10-14T10:01Z,1,2,3\n")
    assert read_weather(path).note().endswith("first in line 2: ghi INF, not in -50..2500")


def test_an_empty_file_of_readings_is_refused_as_empty(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("")
    with pytest.raises(UserError, match=rf"^{path} is empty: name a CSV file with the columns time,east"):
        read_csv(path)


@pytest.mark.parametrize(("read", "head", "row"), [*TABLES[:2], TABLES[3], WEATHER])
def test_a_second_line_of_a_header_is_refused_with_what_to_do(tmp_path, read, head, row):
    path = tmp_path / "table.csv"
    for time in ("", "UTC"):
        path.write_text(f"{head}\n{time}{',W/m2' * head.count(',')}\n{row}\n")
        with pytest.raises(UserError, match=rf"{path}, line 2: .*; remove a second line of the header, such as units$"):
            read(path)
    path.write_text(f"{head}\n{row}\nUTC{',1' * head.count(',')}\n")
    with pytest.raises(UserError, match=rf"{path}, line 3: ") as refused:
        read(path)
    assert "second line" not in str(refused.value)


def test_a_row_of_readings_takes_no_more_memory_than_its_numbers(tmp_path):
    path, count = tmp_path / "faces.csv", 4000
    hours = [f"2022-10-{1 + at // 1440:02d}T{at // 60 % 24:02d}:{at % 60:02d}Z" for at in range(count)]
    lines = [f"{hour},{at}.25,{at % 900}.5,{at % 700}.75,{at % 80}" for at, hour in enumerate(hours)]
    path.write_text("\n".join(["time,east,south,west,zenith", *lines]))
    tracemalloc.start()
    try:
        rows = read_csv(path).rows
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(rows) == count
    # Five numbers of 8 bytes, and spare room in growing arrays.
    assert taken / count < 80
