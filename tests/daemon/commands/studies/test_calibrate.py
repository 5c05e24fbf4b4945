import csv
import functools
import gzip
import json
import re
from contextlib import closing

import numpy as np
import pytest

from daemon.base.records import FACES, FaceReading, Quality, Scan
from daemon.cube.calibration import read_calibration
from daemon.store.schema import FILE_NAME, RowConverter, open_for_writing
from sim_drivers.scene import FaceGeometry, Scene, SensorModel
from sim_drivers.weather import GeneratedWeather
from solar.calibration.attitude import attitude, face_orientations
from solar.ephemeris import Site, sun_position
from tests.support.clear_sky import ClearSky

pytestmark = pytest.mark.slow

SIRTA = Site(48.717607, 2.209002, 156.0)
SITE = ("--site", "48.717607,2.209002,156")
BEGIN = 1_646_956_800.0  # 2022-03-11
MAY = 1_462_060_800.0  # 2016-05-01
GAINS = np.array([1.03, 0.97, 1.02, 0.98])
OFFSETS_MV = np.array([0.05, -0.03, 0.02, 0.0])


def iso(utc_s):
    return f"{np.datetime64(round(utc_s * 1000), 'ms')}Z"


def write(path, header, rows):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


@functools.cache
def horizontal(weather, days):
    """Return instants a minute apart and GHI: the first morning under that weather, the rest under a clear sky."""
    clear, cloudy = (
        Scene(SIRTA, GeneratedWeather(name, SIRTA, 1), faces=[FaceGeometry(180.0, 0.0)] * 4)
        for name in ("clear", weather)
    )
    utc_s = BEGIN + np.arange(0.0, days * 86400.0, 60.0)
    noon = BEGIN + 43200.0
    return utc_s, [(cloudy if now < noon else clear).irradiances(now).zenith_w_m2 for now in utc_s.tolist()]


def beside(folder, ahead_s=37.0, weather="variable", days=2):
    """Write the readings of four sensors beside a reference, their clock `ahead_s` ahead."""
    utc_s, ghi = horizontal(weather, days)
    reference = write(
        folder / "reference.csv", ["time", "ghi"], [(iso(t), f"{g - 2.0:.3f}") for t, g in zip(utc_s, ghi, strict=True)]
    )
    sensors = write(
        folder / "sensors.csv",
        ["time", *(f"{face}_mv" for face in FACES)],
        [
            (iso(t + ahead_s), *(f"{mv:.5f}" for mv in 0.1 * g * GAINS + OFFSETS_MV))
            for t, g in zip(utc_s, ghi, strict=True)
        ],
    )
    return reference, sensors


@functools.cache
def in_place(days=3, sky="perez1990"):
    standing = face_orientations(attitude(2.0, 1.0, 140.0, SIRTA.latitude_deg), SIRTA.latitude_deg)
    faces = [FaceGeometry(*face) for face in zip(*standing, strict=True)]
    sensors = SensorModel(gain_error=0.0)
    scene = Scene(SIRTA, ClearSky(SIRTA), sky_model=sky, albedo=0.35, sensors=sensors, faces=faces)
    utc_s = MAY + np.arange(0.0, days * 86400.0, 300.0)
    utc_s = utc_s[sun_position(utc_s, *SIRTA).elevation_deg > -12.0]
    return utc_s, np.array([[scene.sensor_voltage(k, now) for k in range(4)] for now in utc_s.tolist()]) * 1e4 * GAINS


def fill_store(folder, utc_s, faces, identifier="", simulated=0):
    with closing(open_for_writing(folder / FILE_NAME)) as store:
        store.execute("BEGIN")
        store.execute("INSERT INTO runs VALUES (1, 0, 'both', '0', ?, 'SIRTA', 48.7, 2.2, 156, '', '')", (simulated,))
        rows = RowConverter(Scan)
        for number, (now, row) in enumerate(zip(utc_s.tolist(), faces.tolist(), strict=True)):
            readings = [FaceReading(value, Quality.OK, now, now) for value in row]
            scan = Scan("cube", "s", number, now, now, *readings, calibration=identifier)
            store.execute(rows.insert, rows.row(1, number, scan))
        store.execute("COMMIT")
    return folder


def test_calibrating_beside_a_reference_finds_lag_gains_and_offsets_and_writes_them(heliocube, tmp_path):
    out = tmp_path / "calibration.toml"
    code, told, err = heliocube(
        "calibrate", "cube", *beside(tmp_path), *SITE, "--out", out,
        "--serial", "zenith=RG7", "--serial", "reference=CMP22 1",
    )  # fmt: skip
    assert (code, err) == (0, "")
    made = read_calibration(out)
    for place, name in enumerate(FACES):
        face = getattr(made, name)
        assert face.gain_w_m2_per_mv == pytest.approx(10.0 / GAINS[place], rel=0.0005)
        assert face.offset_mv == pytest.approx(OFFSETS_MV[place], abs=0.003)
        assert 1.5 <= face.gain_uncertainty_percent < 2.0
    assert (made.zenith.serial, made.east.serial, made.reference) == ("RG7", "unknown", "CMP22 1")
    assert made.calibrated_utc.isoformat().startswith("2022-03-12T")
    assert (made.expires_utc - made.calibrated_utc).days == 730
    lines = told.splitlines()
    lag = float(lines[1].split()[4])
    assert lag == pytest.approx(37.0, abs=2.0)
    after = lines.index("After       RG-Z  RG-W  RG-S  RG-E")
    for line, most in zip(lines[after + 1 : after + 5], (0.1, 0.1, 0.1, 0.1), strict=True):
        assert all(abs(float(cell)) <= most for cell in line.split()[2:]), line
    before = next(line for line in lines if line.startswith("rMBE"))
    assert [float(cell) for cell in before.split()[2:]] == pytest.approx([-2.0, 2.0, -3.0, 3.0], abs=0.2)
    assert f"# {lines[0]}" in out.read_text()


def test_impossible_values_count_as_missing_readings_and_a_warning_counts_them(heliocube, tmp_path):
    tables = []
    for path, wrong in zip(beside(tmp_path, days=1), ("-9999", "-9999,1,99999,1"), strict=True):
        lines = path.read_text().splitlines()
        # Some rows of each hour, and all of the night.
        bad = [row for row in range(1, len(lines)) if row % 20 == 7 or row < 300]
        for marked in (False, True):
            for row in bad:
                lines[row] = f"{lines[row].split(',')[0]},{wrong if marked else wrong.count(',') * ','}"
            tables.append(path.with_stem(f"{path.stem}-{marked}"))
            tables[-1].write_text("\n".join(lines))
    empty, marked = (
        heliocube("calibrate", "cube", *tables[place::2], *SITE, "--out", tmp_path / f"{place}.toml")
        for place in range(2)
    )
    assert (empty[0], empty[2]) == (0, "")
    assert marked[0] == 0
    assert marked[1].splitlines()[:-1] == empty[1].splitlines()[:-1]
    told = "impossible values, taken as missing; first in line 2:"
    first, second = marked[2].splitlines()
    assert f"{tables[1]} has {len(bad)} {told} ghi -9999, not in -50..2500" in first
    assert f"{tables[3]} has {2 * len(bad)} {told} east_mv -9999, not in -1000..1000" in second


def test_a_calibration_that_dropped_most_of_the_series_is_marked_doubtful(heliocube, tmp_path):
    tables = beside(tmp_path, ahead_s=3600.0, weather="clear")
    out = tmp_path / "c.toml"
    code, told, _ = heliocube("calibrate", "cube", *tables, *SITE, "--out", out)
    line = "Doubtful: most of the series of east, south, west, zenith were dropped, and the rest may agree by chance; "
    assert code == 0
    assert f"{line}check that" in " ".join(told.split())
    assert "# Doubtful: " in out.read_text()
    assert told.endswith(f" written to {out}; do not use it until the doubts are resolved\n")
    right = ("calibrate", "cube", *tables, *SITE, "--out", tmp_path / "right.toml", "--lag", "3600", "--json")
    assert json.loads(heliocube(*right)[1])["doubtful"] is False


def test_voltages_in_volts_instead_of_millivolts_are_refused(heliocube, tmp_path):
    reference, sensors = beside(tmp_path, days=1)
    header, *lines = (line.split(",") for line in sensors.read_text().splitlines())
    volts = write(
        tmp_path / "volts.csv", header, [[at, *(f"{float(mv) / 1e3:.9f}" for mv in mvs)] for at, *mvs in lines]
    )
    code, _, err = heliocube("calibrate", "cube", reference, volts, *SITE, "--out", tmp_path / "c.toml")
    assert (code, err.count("\n")) == (2, 1)
    assert err.startswith("heliocube: the east sensor's gain would be 9709 W/m2/mV: are the voltages in mV?")


def test_a_reference_file_that_was_cut_off_is_refused(heliocube, tmp_path):
    reference, sensors = tmp_path / "reference.csv.gz", tmp_path / "sensors.csv"
    sensors.write_text("time,east_mv,south_mv,west_mv,zenith_mv\n2022-03-11T12:00:00Z,1,1,1,1\n")
    reference.write_bytes(gzip.compress(b"".join(b"2022-03-11T12:%d,%d\n" % (n, n * n) for n in range(9999)))[:3000])
    code, _, err = heliocube("calibrate", "cube", reference, sensors, *SITE, "--out", tmp_path / "c.toml")
    assert (code, err.count("\n")) == (2, 1)
    assert f"{reference} cannot be read" in err


def test_the_service_measures_with_the_calibration_and_names_it_in_every_scan(heliocube, tmp_path):
    calibration = tmp_path / "calibration.toml"
    told = heliocube(
        "calibrate", "cube", *beside(tmp_path), *SITE, "--out", calibration, "--valid-days", "200", "--json"
    )
    identifier = read_calibration(calibration).identifier
    page = json.loads(told[1])
    assert page["calibration"]["identifier"] == identifier
    assert page["agreement"]["zenith"]["before"]["rmbe_percent"] == pytest.approx(-2.0, abs=0.2)
    for name, line in (("plain", ""), ("calibrated", 'calibration_file = "calibration.toml"')):
        config = tmp_path / f"{name}.toml"
        config.write_text(f"[cube]\n{line}\n")
        run = heliocube("simulate", "--config", config, "--start", "2022-10-12T10:00", "--days", "0.01",
                        "--out", tmp_path / name)  # fmt: skip
        assert run[0] == 0
    plain, calibrated = (
        list(csv.DictReader((tmp_path / name / "scans.csv").read_text().splitlines()))
        for name in ("plain", "calibrated")
    )
    assert {row["calibration"] for row in plain} == {""}
    assert {row["calibration"] for row in calibrated} == {identifier}
    east = float(calibrated[50]["east_w_m2"]) / float(plain[50]["east_w_m2"])
    assert east == pytest.approx(1.0 / GAINS[0], abs=0.01)
    events = (tmp_path / "calibrated" / "events.csv").read_text()
    assert f"the calibration {identifier} expired on 2022-09-2" in events


def test_the_field_calibration_reads_a_store_and_corrects_the_gains(heliocube, tmp_path):
    utc_s, faces = in_place()
    fill_store(tmp_path, utc_s, faces)
    out = tmp_path / "field.toml"
    code, told, err = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", out)
    assert (code, err) == (0, "")
    made = read_calibration(out)
    assert made.method == "in place"
    assert made.standing.yaw_deg == pytest.approx(2.0, abs=0.3)
    assert made.standing.tilt_deg == pytest.approx(1.0, abs=0.3)
    assert made.east.gain_w_m2_per_mv / made.south.gain_w_m2_per_mv == pytest.approx(0.97 / 1.03, rel=0.005)
    assert "albedo" in told
    csv_out = tmp_path / "again.toml"
    heliocube("export", "--store", tmp_path, "--out", tmp_path / "tables", "--kind", "scans")
    ghi = ClearSky(SIRTA).at(utc_s).ghi_w_m2
    nearby = write(tmp_path / "roof.csv", ["time", "ghi"], [(iso(t), g - 3.0) for t, g in zip(utc_s, ghi, strict=True)])
    _, told, _ = heliocube(
        "calibrate", "field", tmp_path / "tables" / "scans.csv", *SITE, "--out", csv_out, "--json",
        "--ghi", nearby, "--ghi-uncertainty", "0.5",
    )  # fmt: skip
    page = json.loads(told)
    assert page["standing"]["yaw_deg"] == pytest.approx(2.0, abs=0.3)
    assert page["level_by"] == ["the GHI of roof.csv (U 0.5 %)"]
    again = read_calibration(csv_out)
    assert again.standing.yaw_deg == pytest.approx(made.standing.yaw_deg, abs=0.01)
    assert again.zenith.gain_w_m2_per_mv == pytest.approx(10.0 / GAINS[3], rel=0.002)
    assert 0.45 < again.zenith.gain_uncertainty_percent < 0.7
    assert again.reference == "clear sky, perez1990, the GHI of roof.csv (U 0.5 %)"


def test_a_field_calibration_under_a_sky_without_a_horizon_band_reports_a_band_of_0(heliocube, tmp_path):
    fill_store(tmp_path, *in_place(sky="isotropic"))
    code, told, _ = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", tmp_path / "field.toml")
    assert code == 0
    assert "the readings fit best with 0.0 of the Perez model's horizon band" in " ".join(told.split())


def test_a_calibration_by_simulated_readings_is_marked_as_simulated(heliocube, tmp_path):
    mark = "SIMULATED: these readings come from a model or a bench, not from a cube."
    out, figure = tmp_path / "field.toml", tmp_path / "figure.svg"
    fill_store(tmp_path, *in_place(), simulated=1)
    code, told, _ = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", out)
    assert (code, told.splitlines()[0], out.read_text().splitlines()[0]) == (0, mark, f"# {mark}")
    assert read_calibration(out).simulated
    reference, sensors = beside(tmp_path)
    first, *lines = sensors.read_text().splitlines()
    sensors.write_text("\n".join([f"{first},simulated", *(f"{line},true" for line in lines)]))
    asked = ("calibrate", "cube", reference, sensors, *SITE, "--out", tmp_path / "beside.toml")
    code, told, _ = heliocube(*asked, "--plot", figure, "--json")
    assert (code, json.loads(told)["simulated"]) == (0, True)
    assert read_calibration(tmp_path / "beside.toml").simulated
    drawn = figure.read_text()
    assert "<!-- SIMULATED -->" in drawn
    assert len(drawn) > 20_000


def test_a_face_with_a_known_gain_sets_the_level_of_the_other_gains(heliocube, tmp_path):
    utc_s, faces = in_place()
    fill_store(tmp_path, utc_s, faces / [1.0, 1.0, 1.0, GAINS[3]])
    out = tmp_path / "field.toml"
    code, told, _ = heliocube(
        "calibrate", "field", "--store", tmp_path, *SITE, "--out", out, "--referenced", "zenith=0.5"
    )
    assert code == 0
    made = read_calibration(out)
    assert made.zenith.gain_w_m2_per_mv == pytest.approx(10.0, rel=0.002)
    assert made.zenith.gain_uncertainty_percent < 0.7 < 2.0 < made.east.gain_uncertainty_percent
    words = " ".join(told.split())
    assert "The level of the gains is held by the gain of zenith (U 0.5 %), and by the clear-sky model." in words
    assert "The gains of the vertical faces follow from that level by the model alone." in words


def test_references_that_contradict_each_other_are_named(heliocube, tmp_path):
    utc_s, faces = in_place()
    ghi = ClearSky(SIRTA).at(utc_s).ghi_w_m2
    roof = write(tmp_path / "roof.csv", ["time", "ghi"], [(iso(t), 1.04 * g) for t, g in zip(utc_s, ghi, strict=True)])
    fill_store(tmp_path, utc_s, faces / [GAINS[0], GAINS[1], GAINS[2] / 1.04, GAINS[3]])
    known = [word for face in ("east=1", "south=1.5", "west=1", "zenith=1") for word in ("--referenced", face)]
    asked = ("calibrate", "field", "--store", tmp_path, *SITE, "--ghi", roof, "--ghi-uncertainty", "1")
    code, told, _ = heliocube(*asked, *known, "--out", tmp_path / "one.toml")
    assert code == 0
    words = " ".join(told.split())
    apart = dict(re.findall(r"put the known (gains? of \w+ and (?:the )?\w+) ([0-9.]+) % apart", words))
    assert set(apart) == {"gains of east and west", "gains of south and west", "gain of zenith and the GHI"}
    assert [float(percent) for percent in apart.values()] == pytest.approx([4.0] * 3, abs=0.4)
    assert "apart, where their uncertainties explain 1.4 %; check each certificate" in words
    _, told, _ = heliocube(*asked, *known[:4], "--out", tmp_path / "other.toml", "--json")
    assert json.loads(told)["contradictions"] == []


def test_a_ghi_of_ten_minute_means_that_does_not_fit_the_cube_is_refused_naming_its_step(heliocube, tmp_path):
    fill_store(tmp_path, *in_place())
    utc_s = MAY + np.arange(0.0, 3 * 86400.0, 60.0)
    means = ClearSky(SIRTA).at(utc_s).ghi_w_m2.reshape(-1, 10).mean(axis=1)
    roof = write(tmp_path / "roof.csv", ["time", "ghi"], [(iso(t), g) for t, g in zip(utc_s[::10], means, strict=True)])
    asked = ("calibrate", "field", "--store", tmp_path, *SITE, "--out", tmp_path / "o.toml", "--ghi", roof)
    code, _, err = heliocube(*asked)
    assert code == 2
    assert "its values are 10 min apart: is each mean's time the middle of its span?" in " ".join(err.split())


def test_field_readings_recorded_under_another_calibration_are_refused(heliocube, tmp_path):
    utc_s, faces = in_place(1)
    fill_store(tmp_path, utc_s, faces, "20220320-0123abcd")
    code, _, err = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", tmp_path / "o.toml")
    assert code == 2
    assert "was recorded under the calibration 20220320-0123abcd, and the settings have none" in " ".join(err.split())


def test_a_field_calibration_with_too_few_clear_days_is_refused_and_says_what_is_missing(heliocube, tmp_path):
    utc_s, faces = in_place(2)
    fill_store(tmp_path, utc_s, faces)
    out = tmp_path / "field.toml"
    code, _, err = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", out)
    assert code == 2
    assert "missing: clear and stable sky on 2 days, where at least 3 are needed" in err
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"site": "91,2"}, "--site: '91,2' is not on Earth: LAT is in -90..90"),
        ({"site": "north"}, "--site: 'north' is not LAT,LON"),
        ({"site": None}, "give the site of the readings"),
        ({"reference": ""}, "reference.csv is empty: name a CSV file with the columns time and ghi"),
        ({"sensors": "\n"}, "sensors.csv is empty: name a CSV file with the columns time, east_mv, south_mv, west_mv"),
        ({"reference": "time,ghi\n"}, "reference.csv has a header and no data: name a file with readings below"),
        ({"reference": "time,ghi,ghi\n2022-03-11,1,2\n"}, "reference.csv has two columns ghi: keep only the right one"),
        ({"reference": "time,dni\n2022-03-11T12:00Z,1\n"}, "has no column ghi; found: time, dni"),
        ({"reference": "time,ghi\n2022-03-11T12:00Z,much\n"}, "line 2: ghi is 'much', not a number"),
        ({"reference": "time,ghi\n2022-03-11T12:00Z,inf\n"}, "line 2: ghi is 'inf', not a number"),
        ({"reference": "time,ghi\n2022-03-11T12:00Z,nan\n"}, "has no reading in its column ghi"),
        ({"reference": "time,ghi\n2022-03-11T12:00Z,-9999\n"}, "has 1 impossible value, taken as missing"),
        ({"reference": "\n \ntime,ghi\n\n2022-03-11T12:00Z,1\n\n\n2022-03-11T12:01Z,much\n"}, "line 8: ghi is 'much'"),
        ({"reference": "time,ghi\nnoon,1\n"}, "line 2: 'noon' is not a time such as"),
        ({"reference": "time,ghi\n2022-03-11T12:00Z,1\n2022-03-11T12:00Z,2\n"}, "line 3: the time does not come after"),
        ({"reference": "time,ghi\n2021-03-11T12:00Z,1\n2021-03-11T12:01Z,2\n"}, "reference and sensors do not overlap"),
        ({}, "reference and sensors overlap at night alone"),
        ({"sensors": "time,east_mv\n2022-03-11T12:00Z,1\n"}, "needs the columns east_mv, south_mv, west_mv, zenith_mv"),
        ({"sensors": "time,east_mv,south_mv,west_mv,zenith_mv\n2022-03-11T12:00Z,1,,1,1\n"}, "has no instant at which"),
        (
            {"sensors": "time,east_mv,south_mv,west_mv,zenith_mv\n2022-03-11T12:00Z,1,1,1,1\n"},
            "sensors.csv has readings of less than a minute: measure on cloudless days",
        ),
        ({"more": ["--serial", "RG7"]}, "--serial: 'RG7' is not NAME=NUMBER"),
        ({"more": ["--plot", "figure.txt"]}, "must end in .png, .svg or .pdf"),
        ({"more": ["--store", "."]}, "give the readings of the cube once"),
        ({"more": ["--from", "2022-03-11"]}, "--from and --to choose from a store"),
        ({"more": ["--out", "none/calibration.toml"]}, "--out: there is no folder none"),
    ],
)
def test_a_mistaken_file_or_option_is_refused_with_the_reason_and_exit_code_2(heliocube, tmp_path, change, message):
    reference, sensors = beside(tmp_path, days=0.02)
    if "reference" in change:
        reference.write_text(change["reference"])
    if "sensors" in change:
        sensors.write_text(change["sensors"])
    site = change.get("site", SITE[1])
    options = [*([] if site is None else ["--site", site]), "--out", tmp_path / "o.toml", *change.get("more", [])]
    code, out, err = heliocube("calibrate", "cube", reference, sensors, *options)
    assert (code, out) == (2, "")
    assert message in " ".join(err.split())
    assert not (tmp_path / "o.toml").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            ("--referenced", "zenith"),
            "--referenced: 'zenith' is not FACE=PERCENT, with one of east, south, west, zenith",
        ),
        (("--referenced", "roof=1"), "--referenced: 'roof=1' is not FACE=PERCENT"),
        (("--referenced", "zenith=nan"), "an uncertainty (k = 2) of 0.1 to 20 %"),
        (("--referenced", "zenith=0.01"), "an uncertainty (k = 2) of 0.1 to 20 %"),
        (("--ghi", "nowhere.csv"), "there is no file nowhere.csv with readings"),
        (("--ghi", "REFERENCE"), "and the cube's readings 2016-05-01T"),
    ],
)
def test_a_mistaken_option_referenced_or_ghi_is_refused_with_its_reason_and_code_2(heliocube, tmp_path, more, message):
    utc_s = MAY + np.arange(0.0, 86400.0, 600.0)
    fill_store(tmp_path, utc_s, np.ones((utc_s.size, 4)))
    reference = write(tmp_path / "reference.csv", ["time", "ghi"], [(iso(BEGIN), 300.0), (iso(BEGIN + 60.0), 301.0)])
    given = [str(reference) if word == "REFERENCE" else word for word in more]
    code, out, err = heliocube("calibrate", "field", "--store", tmp_path, *SITE, "--out", tmp_path / "o.toml", *given)
    assert (code, out) == (2, "")
    assert message in " ".join(err.split())
    assert not (tmp_path / "o.toml").exists()


def test_readings_beside_a_reference_under_an_overcast_sky_are_refused(heliocube, tmp_path):
    reference, sensors = beside(tmp_path, weather="overcast", days=0.5)
    code, _, err = heliocube("calibrate", "cube", reference, sensors, *SITE, "--out", tmp_path / "o.toml")
    assert code == 2
    assert "has a clear and stable sky; measure on cloudless days" in err
