"""Tables of powers as others write them: whose power it is."""

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
def test_a_tracker_is_called_as_the_table_writes_it(tmp_path, names, header):
    frame, _ = read_tables([written(tmp_path / "powers.csv", names, header)])
    assert pair(frame, names).utc_s.size == 9


@pytest.mark.parametrize("name", ["", " "])
def test_a_row_that_does_not_say_whose_power_it_is_is_refused(tmp_path, name):
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
