"""The table of sites: how it is read, and what is wrong with it in a sentence."""

import pytest

from daemon.base.errors import UserError
from daemon.studies.sites.table import YEAR_OF_A_MODEL, read_sites


@pytest.fixture
def table(tmp_path):
    def write(*lines):
        path = tmp_path / "sites.csv"
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    return write


def test_each_line_is_a_site_with_its_weather(table, tmp_path):
    (tmp_path / "2016-01.csv").touch()
    (tmp_path / "2016-02.csv").touch()
    path = table(
        "name, latitude,longitude,altitude,weather,year",
        "Lyngby,55.8,12.5,50,2016-*.csv,",
        "SIRTA,48.7,2.2,,broken,2020",
        "SIRTA,48.7,2.2,,,",
    )
    lyngby, sirta, modelled = read_sites(path, "clear")
    assert lyngby.place == (55.8, 12.5, 50.0)
    assert lyngby.weather == (tmp_path / "2016-01.csv", tmp_path / "2016-02.csv")
    assert (lyngby.year, lyngby.weather_text) == (None, "2016-01.csv;2016-02.csv")
    assert (sirta.weather, sirta.year, sirta.altitude_m) == ("broken", 2020, 0.0)
    assert (modelled.weather, modelled.year) == ("clear", YEAR_OF_A_MODEL)


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        (("name,latitude", "x,1"), "has no column longitude"),
        (("name,latitude,longitude,alt", "x,1,2,3"), "has a column alt, which is not known"),
        (("name,latitude,longitude",), "has no line with a site"),
        (("name,latitude,longitude", "x,91,2"), r"line 2: '91,2,0' is not on Earth"),
        (("name,latitude,longitude", "x,nan,2"), r"line 2: 'nan,2,0' is not LAT,LON"),
        (("name,latitude,longitude", "x,north,2"), r"line 2: 'north,2,0' is not LAT,LON"),
        (("name,latitude,longitude", ",1,2"), "line 2 has no name"),
        (("name,latitude,longitude", "x,1,2,3"), "line 2 has more cells than"),
        (
            ("name,latitude,longitude,weather", "x,1,2,clear", '"y,3,4,clear', "z,5,6,clear"),
            "line 3: a cell begins with a quotation mark and no mark ends it",
        ),
        (("name,latitude,longitude", "x,1,2"), "line 2 has no weather: name its files there, or with --model"),
        (("name,latitude,longitude,weather", "x,1,2,no.csv"), "line 2: there is no weather file 'no.csv'"),
        (("name,latitude,longitude,weather,year", "x,1,2,clear,soon"), r"'soon' is not a year in 1950\.\.2100"),
        (("name,latitude,longitude,weather", "x,1,2,clear", "x,1,3,clear"), "has 'x' at two places"),
        (("name,latitude,longitude,weather", "x,1,2,clear", "x,1,2,clear"), "has 'x' twice with the same weather"),
    ],
)
def test_a_mistake_in_the_table_of_sites_is_refused_with_a_sentence_that_names_its_place(table, lines, sentence):
    with pytest.raises(UserError, match=sentence):
        read_sites(table(*lines), None)


def test_a_year_beside_weather_files_is_refused(table, tmp_path):
    (tmp_path / "w.csv").touch()
    with pytest.raises(UserError, match="line 2 has a year; weather files have their own"):
        read_sites(table("name,latitude,longitude,weather,year", "x,1,2,w.csv,2016"), None)


def test_a_table_of_sites_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(UserError, match="cannot be read: No such file"):
        read_sites(tmp_path / "none.csv", None)
