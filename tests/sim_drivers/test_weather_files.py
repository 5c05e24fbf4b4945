import gzip
import lzma

import numpy as np
import pandas as pd
import pytest

from sim_drivers.weather import GeneratedWeather, WeatherError
from sim_drivers.weather_files import MeasuredWeather, WeatherFileError, load_weather, site_mismatch
from solar.ephemeris import Site

LYNGBY = Site(55.79064, 12.52505, 50.0)
SIRTA = Site(48.717607, 2.209002, 156.0)


def utc(text):
    return pd.Timestamp(text, tz="UTC").timestamp()


def written(folder, text, name="weather.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def reason(path, **options):
    with pytest.raises(WeatherFileError) as caught:
        load_weather(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def at(weather, text):
    return weather.at(np.array([utc(text)]))


TWICE = "keep only the right one"
EMPTY = "leave the cell empty where the value is missing"
CSV = """time,ghi,dni,dhi,wind_speed,temp_air
2016-06-05T12:00:00Z,800.0,900.0,80.0,3.0,20.0
2016-06-05T12:01:00Z,820.0,,90.0,5.0,21.0
2016-06-05T12:02:00+00:00,840.0,920.0,100.0,,
2016-06-05T14:03:00+02:00,-1.5,-0.3,-1.4,7.0,23.0
"""


@pytest.mark.parametrize("packed", [None, "gz", "GZ"])
def test_the_csv_format_is_read_plain_and_gzipped_and_interpolated_over_missing_cells(tmp_path, packed):
    path = written(tmp_path, CSV)
    if packed:
        path = tmp_path / f"weather.csv.{packed}"
        path.write_bytes(gzip.compress(CSV.encode()))
    weather = load_weather(path)
    assert weather.site is None
    assert (weather.start_utc_s, weather.end_utc_s) == (utc("2016-06-05T12:00"), utc("2016-06-05T12:03"))
    middle = at(weather, "2016-06-05T12:01:00")
    # The record with a missing dni does not count: all three come from its neighbours.
    assert (middle.ghi_w_m2[0], middle.dni_w_m2[0], middle.dhi_w_m2[0]) == (820.0, 910.0, 90.0)
    assert middle.wind_speed_m_s[0] == 5.0
    later = at(weather, "2016-06-05T12:02:00")
    assert (later.wind_speed_m_s[0], later.temp_air_degc[0]) == (6.0, 22.0)


def test_negative_night_values_become_zero(tmp_path):
    last = at(load_weather(written(tmp_path, CSV)), "2016-06-05T12:03:00")
    assert (last.ghi_w_m2[0], last.dni_w_m2[0], last.dhi_w_m2[0]) == (0.0, 0.0, 0.0)


def test_columns_may_come_in_any_order_with_a_byte_order_mark_and_blank_lines_at_the_end(tmp_path):
    text = "\ufeffdhi, TIME ,dni,ghi,note\n80,2016-06-05 12:00,900,800,hazy\n90,2016-06-05T12:01,910,810,NaN\n\n\n"
    weather = load_weather(written(tmp_path, text))
    now = at(weather, "2016-06-05T12:00:30")
    assert (now.ghi_w_m2[0], now.dni_w_m2[0], now.dhi_w_m2[0]) == (805.0, 905.0, 85.0)
    assert np.isnan(now.wind_speed_m_s[0])
    assert np.isnan(now.temp_air_degc[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "{path} is empty: name one with records, such as CSV with the columns time, ghi, dni and dhi"),
        ("\n \n", "{path} is empty: name one with records, such as CSV with the columns time, ghi, dni and dhi"),
        ("time,ghi,dni,dhi\n", "{path} has a header and no data: name one with records below it"),
        ("time,ghi,dni,dhi\n2016-06-05T12:00:00Z,,,\n", "{path} has no record with ghi, dni and dhi all present"),
        (CSV.replace("dhi", "x"), "{path} has no column dhi; found: time, ghi, dni, x, wind_speed, temp_air"),
        (CSV.replace("time,", "when,"), "{path} has no column time; found: when, ghi, dni, dhi, wind_speed, temp_air"),
        (
            CSV.replace("2016-06-05T12:01:00Z", "5 June noon"),
            "{path}, line 3: '5 June noon' is not a time such as 2016-06-05T12:00:00Z",
        ),
        (
            CSV.replace("2016-06-05T12:02:00+00:00", "2016-06-05T11:02:00Z"),
            "{path}, line 4: the time 2016-06-05T11:02:00Z follows 2016-06-05T12:01:00Z; times must increase",
        ),
        (
            CSV.replace("12:01:00Z", "12:00:00Z"),
            "{path}, line 3: the time 2016-06-05T12:00:00Z follows 2016-06-05T12:00:00Z; times must increase",
        ),
        (
            CSV.replace("920.0", "cloud"),
            "{path}, line 4: dni is 'cloud', not a number; " + EMPTY,
        ),
        (
            "time,ghi,dni,dhi\n2016-06-05T12:00:00Z,1,2,3,4\n",
            "{path} has more cells in its lines than names in its header",
        ),
        ("time,ghi,dni,dhi,ghi\n2016-06-05T12:00Z,1,2,3,4\n", "{path} has two columns ghi: " + TWICE),
        ("time,ghi,dni,dhi,GHI\n2016-06-05T12:00Z,1,2,3,4\n", "{path} has two columns ghi: " + TWICE),
    ],
)  # fmt: skip
def test_a_bad_csv_is_refused_with_one_sentence_that_names_the_place(tmp_path, text, expected):
    path = written(tmp_path, text)
    assert reason(path) == "weather file " + expected.format(path=path)


def test_an_impossible_value_is_a_missing_one_and_is_counted(tmp_path):
    path = written(tmp_path, CSV.replace("-1.5", "-9999").replace("7.0", "inf"))
    weather = load_weather(path)
    assert weather.utc_s.size == load_weather(written(tmp_path, CSV, "good.csv")).utc_s.size - 1
    assert weather.note() == (
        f"weather file {path} has 2 impossible values, taken as missing; first in line 5: ghi -9999, not in -50..2500"
    )


def test_a_file_without_any_possible_value_is_refused_with_the_reason(tmp_path):
    path = written(tmp_path, "time,ghi,dni,dhi\n2016-06-05T12:00:00Z,800000,900000,80000\n")
    assert reason(path) == (
        f"weather file {path} has no record with ghi, dni and dhi all present; weather file {path} has 3 impossible"
        " values, taken as missing; first in line 2: ghi 800000, not in -50..2500"
    )


def test_a_missing_file_a_folder_and_a_broken_archive_are_refused(tmp_path):
    assert reason(tmp_path / "no.csv") == f"there is no weather file at {tmp_path / 'no.csv'}"
    assert reason(tmp_path) == f"{tmp_path} is a folder: name a file of measured weather in it"
    broken = tmp_path / "weather.csv.gz"
    broken.write_bytes(gzip.compress(CSV.encode())[:40])
    assert "cannot be read" in reason(broken)
    broken = tmp_path / "weather.csv.xz"
    broken.write_bytes(lzma.compress(CSV.encode())[:40])
    assert "cannot be read" in reason(broken)
    ragged = written(tmp_path, CSV + "2016-06-05T12:04:00Z,1,2,3,4,5,6,7\n")
    assert "line 6" in reason(ragged)


def hours(*present):
    rows = [f"2016-06-05T{hour:02d}:00:00Z,{hour * 10},0,{hour * 10},{wind}" for hour, wind in present]
    return "\n".join(["time,ghi,dni,dhi,wind_speed", *rows]) + "\n"


def test_gaps_of_an_hour_are_bridged_and_longer_ones_are_named(tmp_path):
    path = written(tmp_path, hours((6, 2), (7, ""), (8, 4), (11, 5), (12, 6)))
    weather = load_weather(path)
    assert at(weather, "2016-06-05T06:30").dhi_w_m2[0] == 65.0
    assert at(weather, "2016-06-05T11:00").dhi_w_m2[0] == 110.0
    asked = utc("2016-06-05T07:00") + 3600.0 * np.arange(7.0)
    assert weather.covers(asked).tolist() == [True, True, False, False, True, True, False]
    with pytest.raises(WeatherFileError) as caught:
        at(weather, "2016-06-05T09:30")
    assert str(caught.value) == (
        f"weather file {path} has no weather for 2016-06-05T09:30:00Z: "
        "it has a gap from 2016-06-05T08:00:00Z to 2016-06-05T11:00:00Z"
    )
    # Irradiance is known here, wind is not: its own gap is two hours long.
    assert np.isnan(at(weather, "2016-06-05T07:30").wind_speed_m_s[0])
    assert at(weather, "2016-06-05T11:30").wind_speed_m_s[0] == 5.5


@pytest.mark.parametrize("outside", ["2016-06-05T05:59:59", "2016-06-05T07:00:01", "2022-10-12"])
def test_asking_for_an_instant_outside_the_weather_file_is_refused_with_its_span(tmp_path, outside):
    path = written(tmp_path, hours((6, 2), (7, 3)))
    with pytest.raises(WeatherError) as caught:
        at(load_weather(path), outside)
    assert str(caught.value).startswith(f"weather file {path} has no weather for {outside}")
    assert str(caught.value).endswith("it runs from 2016-06-05T06:00:00Z to 2016-06-05T07:00:00Z")


def columns(width, cells):
    """One line of fixed columns: `cells` maps the column after a cell's last character to the cell."""
    line = [" "] * width
    for end, cell in cells.items():
        line[end - len(cell) : end] = cell
    return "".join(line)


def bsrn():
    head = ["*U0001", " 30  3 2016  1", "*U0004", " -1 -1 -1", " 11  2", "Lyngby", "+45                 none"]
    head += ["127.0.0.1      nobody", " 145.791 192.525   50 -1", " -1 -1 -1", "  0  1 90  2", "*U0100"]
    for minute, ghi, dni, dhi in ((719, "500", "600", "100"), (720, "520", "-999", "120"), (721, "540", "640", "140")):
        first = columns(75, {3: " 15", 9: f"{minute:5d}", 16: ghi, 22: "-99.9", 39: dni, 45: "-99.9"})
        head += [first, columns(75, {16: dhi, 22: "-99.9", 39: "300", 45: "-99.9", 64: "21.5", 70: "60.0", 75: "1013"})]
    return "\n".join(head) + "\n"


@pytest.mark.parametrize("packed", [None, "gz", "GZ"])
def test_bsrn_files_are_read_with_their_site(tmp_path, packed):
    path = written(tmp_path, bsrn(), "lyn0316.dat")
    if packed:
        path = tmp_path / f"lyn0316.dat.{packed}"
        path.write_bytes(gzip.compress(bsrn().encode()))
    weather = load_weather(path)
    assert weather.site == pytest.approx((55.791, 12.525, 50.0))
    assert weather.utc_s.tolist() == [utc("2016-03-15T11:59"), utc("2016-03-15T12:01")]
    noon = at(weather, "2016-03-15T12:00")
    assert (noon.ghi_w_m2[0], noon.dni_w_m2[0], noon.dhi_w_m2[0]) == (520.0, 620.0, 120.0)
    assert noon.temp_air_degc[0] == 21.5


def surfrad():
    lines = [" Bondville", "   40.052  -88.373   213 m version 1"]
    for minute, ghi in ((0, "500.0"), (1, "-9999.9"), (2, "520.0")):
        values = {8: ghi, 12: "600.0", 14: "90.0", 38: "21.0", 42: "4.5"}
        pairs = [values.get(position, "-9999.9") + " 0" for position in range(8, 48, 2)]
        lines.append(f" 2016 75  3 15 18 {minute} {18 + minute / 60:.3f} 40.00 " + " ".join(pairs))
    return "\n".join(lines) + "\n"


def test_surfrad_files_are_read_with_their_site(tmp_path):
    weather = load_weather(written(tmp_path, surfrad(), "bon16075.dat"))
    assert weather.site == Site(40.052, -88.373, 213.0)
    now = at(weather, "2016-03-15T18:01")
    assert (now.ghi_w_m2[0], now.dni_w_m2[0], now.dhi_w_m2[0]) == (510.0, 600.0, 90.0)
    assert (now.wind_speed_m_s[0], now.temp_air_degc[0]) == (4.5, 21.0)


MIDC = """DATE (MM/DD/YYYY),MST,Global 40-South LI-200 [W/m^2],Global CMP22 (vent/cor) [W/m^2],Direct CHP1-1 [W/m^2],\
Direct NIP [W/m^2],Diffuse CM22-1 (vent/cor) [W/m^2],Avg Wind Speed @ 6ft [m/s],Tower Dry Bulb Temp [deg C]
03/15/2016,12:00,1,700,800,801,100,3.5,12
03/15/2016,12:01,1,710,-7999,801,100,3.5,12
03/15/2016,12:02,1,720,820,801,110,3.5,12
"""
MIDC_RAW = """Station,Year,DOY,PST,Global Horizontal [W/m^2],Direct Normal [W/m^2],Diffuse Horizontal [W/m^2]
1,2016,75,1200,700,800,100
1,2016,75,1202,720,820,110
"""


@pytest.mark.parametrize(("text", "noon_utc"), [(MIDC, "2016-03-15T19:01"), (MIDC_RAW, "2016-03-15T20:01")])
def test_midc_files_are_read_in_their_own_time_zone_with_their_own_names(tmp_path, text, noon_utc):
    weather = load_weather(written(tmp_path, text, "midc.txt"))
    assert weather.site is None
    now = at(weather, noon_utc)
    assert (now.ghi_w_m2[0], now.dni_w_m2[0], now.dhi_w_m2[0]) == (710.0, 810.0, 105.0)


def test_a_midc_file_without_a_diffuse_column_is_refused_with_the_columns_found(tmp_path):
    message = reason(written(tmp_path, MIDC_RAW.replace("Diffuse Horizontal", "Something"), "midc.txt"))
    assert "has no column for dhi; found: " in message
    assert "Something [W/m^2]" in message


def tmy3(years):
    lines = ['724666,"SOMEWHERE",CO,-7.0,39.742,-105.179,1829']
    lines.append("Date (MM/DD/YYYY),Time (HH:MM),GHI (W/m^2),DNI (W/m^2),DHI (W/m^2),Wspd (m/s),Dry-bulb (C)")
    for date, year in years.items():
        for hour in range(1, 25):
            light = 100 * max(0, 6 - abs(hour - 12))
            lines.append(f"{date}/{year},{hour:02d}:00,{light},{light},{light // 2},3.0,10.0")
    return "\n".join(lines) + "\n"


def test_the_hours_of_tmy3_are_moved_to_their_middle_and_its_months_into_one_year(tmp_path):
    path = written(tmp_path, tmy3({"01/31": 1997, "02/01": 1988}), "724666TYA.csv")
    weather = load_weather(path, typical_year=2022)
    assert weather.site == Site(39.742, -105.179, 1829.0)
    # 12:00 local standard time is the hour from 11 to 12, whose middle is 18:30 UTC.
    assert at(weather, "2022-01-31T18:30").ghi_w_m2[0] == 600.0
    assert at(weather, "2022-01-31T19:00").ghi_w_m2[0] == 550.0
    assert at(weather, "2022-02-01T18:30").dhi_w_m2[0] == 300.0
    assert load_weather(path).start_utc_s == utc("1997-01-31T07:30")


def test_a_damaged_file_of_a_known_format_is_refused_in_one_sentence(tmp_path):
    damaged = {
        "bsrn.dat": bsrn().replace("*U0004", "*U0005"),
        "surfrad.dat": surfrad().replace(" 2016 75", " 2016 xx"),
        "midc.txt": MIDC.replace("03/15/2016,12:01", "yesterday,12:01"),
        "tmy3.csv": tmy3({"01/31": 1997}).replace("GHI (W/m^2)", "Light"),
        "disorder.txt": MIDC.replace("12:02", "11:59"),
    }
    for name, text in damaged.items():
        path = written(tmp_path, text, name)
        assert str(path) in reason(path)


NETWORKS = {
    "lyn0316.dat": (bsrn(), {}),
    "bon16075.dat": (surfrad(), {}),
    "midc.txt": (MIDC, {}),
    "raw.txt": (MIDC_RAW, {}),
    "724666TYA.csv": (tmy3({"06/15": 1997}), {"typical_year": 2022}),
}


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("packed", [False, True])
def test_a_truncated_last_line_of_a_network_file_is_left_out_and_reported(tmp_path, name, packed):
    text, options = NETWORKS[name]
    lines = text.splitlines(keepends=True)
    last = lines.pop()
    path = tmp_path / (f"{name}.gz" if packed else name)

    def read(end):
        content = "".join([*lines, end]).encode()
        path.write_bytes(gzip.compress(content) if packed else content)
        return load_weather(path, **options)

    whole = read("")
    assert whole.note() is None
    cells = len(last.split("," if "," in last else None))
    # The steps cut cells and separators at every place; a packed file is the same text, so fewer cuts will do.
    for cut in range(1, len(last) - 1, 29 if packed else 5):
        begun = last[:cut]
        parts = len(begun.split("," if "," in last else None))
        if not begun.strip() or parts == cells:
            continue
        found = read(begun)
        assert found.note().endswith(
            f"the last line, {len(lines) + 1}, breaks off at cell {parts} of {cells} and is left out"
        )
        assert found.utc_s.tolist() == whole.utc_s.tolist()
    assert read(last.rstrip()).note() is None


def test_a_last_number_of_a_network_file_with_fewer_decimals_than_all_above_counts_as_truncated(tmp_path):
    rows = [f"1,2016,75,12{minute:02},700,800,100.5\n" for minute in range(31)]
    path = written(tmp_path, "".join([*MIDC_RAW.splitlines(keepends=True)[:1], *rows, "1,2016,75,1231,720,820,11"]))
    assert load_weather(path).note().endswith("the last line, 33, breaks off at cell 7 of 7 and is left out")


def test_a_typical_year_that_ends_early_has_its_last_hour_in_the_same_year(tmp_path):
    path = written(tmp_path, tmy3({"06/15": 1997}), "724666TYA.csv")
    assert load_weather(path, typical_year=2022).end_utc_s == utc("2022-06-16T06:30")


def test_measured_days_are_read_whole(measured):
    weather = load_weather(measured / "dtu_lyngby_2016" / "2016-06.csv.gz")
    minutes = utc("2016-06-05") + np.arange(0.0, 86400.0, 60.0)
    assert weather.covers(minutes).all()
    day = weather.at(minutes)
    assert 7000.0 < day.ghi_w_m2.sum() / 60.0 < 9000.0
    assert np.isfinite(day.wind_speed_m_s).all()


def test_measured_weather_fits_its_own_site_and_no_other(measured):
    for month in ("03", "06", "10"):
        weather = load_weather(measured / "dtu_lyngby_2016" / f"2016-{month}.csv.gz")
        assert site_mismatch(weather, LYNGBY) is None
        assert "does not fit a site at 48.7176 N, 2.209 E: " in site_mismatch(weather, SIRTA)
        assert "of its sunshine falls into the night there" in site_mismatch(weather, Site(55.79, -120.0, 0.0))
    assert "ghi - dhi differs from dni sin(elevation) by 24%" in site_mismatch(weather, Site(48.0, 12.5, 0.0))


def test_times_that_are_an_hour_off_are_noticed():
    generated = GeneratedWeather("clear", SIRTA, 1)
    instants = utc("2022-04-12") + np.arange(0.0, 86400.0, 60.0)
    now = generated.at(instants)
    values = {"ghi": now.ghi_w_m2, "dni": now.dni_w_m2, "dhi": now.dhi_w_m2}
    values |= {"wind_speed": now.wind_speed_m_s, "temp_air": now.temp_air_degc}
    assert site_mismatch(MeasuredWeather("it", instants, values), SIRTA) is None
    assert site_mismatch(MeasuredWeather("it", instants + 3600.0, values), SIRTA).startswith(
        "it does not fit a site at 48.7176 N, 2.209 E"
    )


def test_hours_stamped_with_their_end_are_noticed_and_those_with_their_middle_are_not():
    minutes = utc("2022-04-12") + np.arange(0.0, 86400.0, 60.0)
    now = GeneratedWeather("clear", SIRTA, 1).at(minutes)
    light = {"ghi": now.ghi_w_m2, "dni": now.dni_w_m2, "dhi": now.dhi_w_m2}
    means = {key: value.reshape(24, 60).mean(axis=1) for key, value in light.items()}
    means |= {key: np.full(24, np.nan) for key in ("wind_speed", "temp_air")}
    assert site_mismatch(MeasuredWeather("it", minutes[30::60], means), SIRTA) is None
    assert "that means are stamped with their middle" in site_mismatch(
        MeasuredWeather("it", minutes[::60] + 3600.0, means), SIRTA
    )


def test_irradiance_in_kilowatts_is_noticed_in_a_day_and_not_in_a_night():
    instants = utc("2022-04-12") + np.arange(0.0, 86400.0, 60.0)
    now = GeneratedWeather("overcast", SIRTA, 1).at(instants)
    values = {"ghi": now.ghi_w_m2, "dni": now.dni_w_m2, "dhi": now.dhi_w_m2}
    kilowatts = {key: value / 1000.0 for key, value in values.items()}
    others = {"wind_speed": now.wind_speed_m_s, "temp_air": now.temp_air_degc}
    assert site_mismatch(MeasuredWeather("it", instants, values | others), SIRTA) is None
    told = site_mismatch(MeasuredWeather("it", instants, kilowatts | others), SIRTA)
    assert told.startswith("it has at most 0.")
    assert told.endswith(" W/m2 of ghi by day: if it is in kW/m2, multiply it by 1000")
    night = {key: value[:200] for key, value in (kilowatts | others).items()}
    assert site_mismatch(MeasuredWeather("it", instants[:200], night), SIRTA) is None


def test_a_day_without_sunshine_fits_any_site():
    instants = utc("2022-10-12") + np.arange(0.0, 86400.0, 60.0)
    grey = np.full(instants.shape, 80.0)
    values = {"ghi": grey, "dni": 0.0 * grey, "dhi": grey, "wind_speed": grey, "temp_air": grey}
    assert site_mismatch(MeasuredWeather("it", instants, values), LYNGBY) is None
