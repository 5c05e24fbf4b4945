"""Tables of powers that others write: which tracker a power belongs to."""

import pytest

from daemon.base.errors import UserError
from daemon.studies.compare.pairs import pair, read_tables


def written(path, names, header="time,tracker,pmpp_w"):
    separator = ";" if ";" in header else ","
    rows = [separator.join((f"2022-10-12T10:00:{n:02d}Z", name, "100")) for n in range(9) for name in names]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.mark.parametrize("names", [("NA", "EU"), ("01", "02"), ("1e3", "1000"), ("null", "nan")])
@pytest.mark.parametrize("header", ["time,tracker,pmpp_w", "Time, Tracker, Pmpp_W", "time;tracker;pmpp_w"])
def test_a_tracker_has_exactly_the_name_in_the_table_even_if_it_looks_like_a_number_or_nan(tmp_path, names, header):
    frame, _ = read_tables([written(tmp_path / "powers.csv", names, header)])
    assert pair(frame, names).utc_s.size == 9


@pytest.mark.parametrize("name", ["", " "])
def test_a_row_of_powers_without_a_tracker_name_is_refused_with_its_row_number(tmp_path, name):
    path = written(tmp_path / "powers.csv", ("one", "other"))
    path.write_text(path.read_text() + f"2022-10-12T10:01:00Z,{name},100\n")
    parquet = tmp_path / "powers.parquet"
    frame, _ = read_tables([written(tmp_path / "good.csv", ("one", "other"))])
    frame["time"] = "2022-10-12T10:00:00Z"
    frame.loc[len(frame) - 1, "tracker"] = name or None
    frame.to_parquet(parquet)
    for table, row in ((path, 19), (parquet, 18)):
        with pytest.raises(UserError, match=rf"{table.name}, row {row}: there is no tracker's name"):
            read_tables([table])


@pytest.mark.parametrize(
    "wrong",
    ["noon,one,1,1", "2022-10-12T10:00:00Z,,1,1", "2022-10-12T10:00:00Z,one,x,1", "2022-10-12T10:00:00Z,one,9999,1"],
)
def test_the_row_number_of_a_wrong_row_counts_rows_of_empty_cells_before_it(tmp_path, wrong):
    path = tmp_path / "powers.csv"
    path.write_text(f"time,tracker,pmpp_w,ghi_w_m2\n2022-10-12T09:00:00Z,one,1,1\n,,,\n{wrong}\n")
    with pytest.raises(UserError, match=r"powers\.csv, row 3: "):
        read_tables([path])


def test_an_impossible_irradiance_is_reported_with_its_row_number(tmp_path):
    path = tmp_path / "powers.csv"
    path.write_text(
        "time,tracker,pmpp_w,ghi_w_m2\n2022-10-12T09:00:00Z,one,1,1\n,,,\n2022-10-12T10:00:00Z,one,1,-9999\n"
    )
    (note,) = read_tables([path])[1]
    assert "first in row 3: ghi_w_m2 -9999" in note
