import csv
import hashlib
import json
import logging
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from daemon.base.errors import UserError
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge.refusals import ScanRefusedError
from daemon.bridge.senml import decode, encode
from daemon.commands.file_check import check_file
from daemon.config.file import ConfigError, load_settings
from daemon.config.sections import CubeSettings
from daemon.cube.calibration import ExpiryWatch, calibrated_cube, new_calibration, read_calibration, write_calibration
from daemon.store.export import export
from daemon.store.schema import FILE_NAME, VERSION, RowConverter, open_for_writing
from daemon.studies.calibrate.readings import read_store
from tests.daemon.store.test_full_disk import fill, small_disk

__all__ = ["small_disk"]

MADE = datetime(2022, 3, 20, 15, 0, tzinfo=UTC)
EXPIRES = datetime(2024, 3, 20, 15, 0, tzinfo=UTC)


def face(gain=10.2, offset_mv=0.05):
    return {
        "serial": 'RG "7"',
        "gain_w_m2_per_mv": gain,
        "gain_uncertainty_percent": 1.6,
        "offset_mv": offset_mv,
        "offset_uncertainty_mv": 0.01,
    }


ADDRESSES = """
[instruments.multiplexer]
digital_port = "Dev1/port0"
[instruments.voltmeter]
resource = "GPIB0::16::INSTR"
[bridge]
insecure = true
"""


def calibration(**changes):
    values = {
        "method": "beside a reference",
        "calibrated_utc": MADE,
        "expires_utc": EXPIRES,
        "cube": "cube",
        "reference": "CMP22 1234",
        "east": face(10.1),
        "south": face(10.2),
        "west": face(10.3),
        "zenith": face(10.4, -0.02),
    }
    return new_calibration(values | changes)


def scan(identifier, sequence=0):
    reading = FaceReading(100.0, Quality.OK, 1.6e9, 50.0)
    return Scan("cube", "session", sequence, 1.6e9, 50.0, reading, reading, reading, reading, calibration=identifier)


def written(tmp_path, made=None):
    path = tmp_path / "calibration.toml"
    write_calibration(made or calibration(), path, ["MBE 0.3", "", "two\nlines"])
    return path


def test_only_a_calibration_by_simulated_readings_is_marked_and_a_removed_mark_is_noticed(tmp_path):
    assert "simulated" not in written(tmp_path).read_text()
    marked = calibration(simulated=True)
    assert marked.identifier != calibration().identifier
    file = tmp_path / "simulated.toml"
    write_calibration(marked, file, [])
    file.write_text(file.read_text().replace("simulated = true\n", ""))
    with pytest.raises(UserError, match="has been edited"):
        read_calibration(file)


@pytest.mark.parametrize(
    ("instruments", "good"), [("kind = 'real'", False), ("kind = 'real'\nbench = true", True), ("", True)]
)
def test_only_a_bench_or_a_simulated_rig_takes_a_calibration_by_simulated_readings(
    heliocube, tmp_path, instruments, good
):
    written(tmp_path, calibration(simulated=True))
    file = tmp_path / "rig.toml"
    file.write_text(f"[cube]\ncalibration_file = 'calibration.toml'\n[instruments]\n{instruments}\n{ADDRESSES}")
    code, _, err = heliocube("config", "check", file, "--role", "cube")
    sentence = f"calibration file {tmp_path / 'calibration.toml'} is SIMULATED, made from readings of a model"
    assert (code, sentence in err) == ((0, False) if good else (2, True))
    if not good:
        code, _, err = heliocube("run", "--config", file, "--role", "cube", "--for", "0")
        assert (code, err.startswith(f"heliocube: {sentence}"), err.count("\n")) == (2, True, 1)


def test_a_calibration_that_is_written_and_read_again_is_unchanged(tmp_path):
    assert read_calibration(written(tmp_path)) == calibration()


@given(st.floats(0.001, 1000), st.floats(-100, 100))
def test_the_identifier_is_made_of_the_day_and_the_contents(gain, offset_mv):
    made = calibration(east=face(gain, offset_mv))
    assert made.identifier == calibration(east=face(gain, offset_mv)).identifier
    assert made.identifier.startswith("20220320-")
    assert (made.identifier == calibration().identifier) == (gain == 10.1 and offset_mv == 0.05)


def test_the_identifier_of_a_calibration_does_not_depend_on_the_order_of_its_contents():
    made = calibration()
    contents = json.dumps(made.model_dump(mode="json", exclude={"identifier", "simulated"}), sort_keys=True)
    assert made.identifier == "20220320-" + hashlib.sha256(contents.encode()).hexdigest()[:8]


STANDING = {
    "yaw_deg": 1.0,
    "yaw_uncertainty_deg": 0.0,
    "tilt_deg": 0.0,
    "tilt_azimuth_deg": 0.0,
    "tilt_uncertainty_deg": 0.0,
    "albedo": 0.0,
    "albedo_uncertainty": 0.0,
}


@pytest.mark.parametrize(("name", "least", "most"), [
    ("gain_w_m2_per_mv", 0.0001, 1000.0),
    ("gain_uncertainty_percent", 0.0, None),
    ("offset_mv", -100.0, 100.0),
    ("offset_uncertainty_mv", 0.0, None),
    ("tilt_deg", 0.0, None),
    ("tilt_azimuth_deg", 0.0, 360.0),
    ("albedo", 0.0, 1.0),
])  # fmt: skip
def test_each_number_of_a_calibration_has_its_bounds(name, least, most):
    def with_value(value):
        if name in STANDING:
            return calibration(standing=STANDING | {name: value})
        return calibration(west=face() | {name: value})

    with_value(least)
    with pytest.raises(ValidationError):
        with_value(least - 0.001)
    if most is not None:
        with_value(most)
        with pytest.raises(ValidationError):
            with_value(most + 0.001)


@pytest.mark.parametrize(("field", "most"), [("cube", 64), ("reference", 400)])
def test_the_cube_and_reference_texts_of_a_calibration_have_a_greatest_length(field, most):
    assert getattr(calibration(**{field: "c" * most}), field) == "c" * most
    with pytest.raises(ValidationError):
        calibration(**{field: "c" * (most + 1)})


def test_a_calibration_can_be_written_after_an_attempt_that_failed_on_a_full_disk(small_disk):
    filler = small_disk / "filler"
    fill(filler)
    path = small_disk / "calibration.toml"
    with pytest.raises(UserError, match="cannot be written: No space left"):
        write_calibration(calibration(), path, ["note"] * 1000)
    filler.unlink()
    write_calibration(calibration(), path, [])
    assert read_calibration(path) == calibration()


def test_a_calibration_is_not_overwritten(tmp_path):
    path = written(tmp_path)
    with pytest.raises(UserError, match="is there already"):
        write_calibration(calibration(), path, [])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("10.4", "10.5"), "has been edited"),
        (("10.4", "nan"), r"zenith.gain_w_m2_per_mv: nan is not a finite number; calibrate again"),
        (("[zenith]", "[zenit]"), "zenith: is missing"),
        (("[zenith]", "[zenith"), "cannot be read"),
    ],
)
def test_a_damaged_calibration_file_is_refused_with_the_reason(tmp_path, change, message):
    path = written(tmp_path)
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(UserError, match=message):
        read_calibration(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(UserError, match="there is no calibration file at"):
        read_calibration(tmp_path / "none.toml")


def test_a_calibration_replaces_gains_and_offsets_of_the_faces_and_nothing_else():
    cube = calibrated_cube(CubeSettings(), calibration())
    assert (cube.zenith.gain_w_m2_per_mv, cube.zenith.offset_mv) == (10.4, -0.02)
    assert cube.east.gain_w_m2_per_mv == 10.1
    assert (cube.zenith.channel, cube.zenith.tilt_deg) == (3, 0.0)


@pytest.mark.parametrize(
    ("left_s", "validity"),
    [
        (30 * 86_400.0 + 1.0, "valid"),
        (30 * 86_400.0, "expires soon"),
        (1.0, "expires soon"),
        (0.0, "expired"),
        (-1.0, "expired"),
        (float("nan"), "expired"),
    ],
)
def test_a_calibration_expires_soon_in_its_last_30_days_and_is_expired_from_the_exact_second_on(left_s, validity):
    assert calibration().validity(EXPIRES.timestamp() - left_s) == validity


def test_the_expiry_of_a_calibration_is_reported_once_beforehand_and_once_when_it_comes(caplog):
    told = []
    watch = ExpiryWatch(calibration(), told.append)
    with caplog.at_level(logging.WARNING, "heliocube.calibration"):
        for days in (-400, -31, -29, -1, 1, 2):
            watch.check((EXPIRES + timedelta(days=days)).timestamp(), 0.0)
    texts = [event.text for event in told]
    assert [text.split(" ", 3)[3] for text in texts] == [
        "expires on 2024-03-20; calibrate the cube again",
        "expired on 2024-03-20; calibrate the cube again",
    ]
    assert [record.getMessage() for record in caplog.records] == texts


def test_an_approaching_expiry_is_reported_again_after_the_clock_was_set_back():
    told = []
    watch = ExpiryWatch(calibration(), told.append)
    for days in (-29, -400, -29):
        watch.check((EXPIRES + timedelta(days=days)).timestamp(), 7.0)
    assert [(event.subject, event.time_monotonic_s) for event in told] == [("calibration", 7.0)] * 2
    ExpiryWatch(None, told.append).check(EXPIRES.timestamp(), 7.0)
    assert len(told) == 2


def test_the_calibration_file_is_found_beside_the_configuration_and_checked(tmp_path):
    written(tmp_path)
    config = tmp_path / "heliocube.toml"
    config.write_text('[cube]\ncalibration_file = "calibration.toml"\n')
    assert load_settings(config).cube.calibration_file == tmp_path / "calibration.toml"
    check_file(config)
    (tmp_path / "calibration.toml").unlink()
    with pytest.raises(ConfigError, match=r"cube\.calibration_file: there is no calibration file"):
        check_file(config)


def test_the_machine_of_a_tracker_alone_needs_no_calibration_file(heliocube, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text("[cube]\ncalibration_file = 'calibration.toml'\n[bridge]\ninsecure = true\n")
    code, _, err = heliocube("config", "check", file, "--role", "tracker")
    assert (code, err) == (0, "")
    for role in ("cube", "both"):
        code, _, err = heliocube("config", "check", file, "--role", role)
        assert (code, "there is no calibration file" in err) == (2, True)


def test_the_identifier_of_a_calibration_or_its_absence_crosses_the_bridge():
    identifier = calibration().identifier
    assert decode(encode(scan(identifier))).calibration == identifier
    assert decode(encode(scan(""))).calibration == ""
    assert b"calibration" not in encode(scan(""))


@pytest.mark.parametrize("text", ["", "2022-3-20", "20220320-ABCDEF01", "20220320-abcdef012"])
def test_a_scan_with_an_invalid_calibration_identifier_is_refused(text):
    good = calibration().identifier.encode()
    with pytest.raises(ScanRefusedError, match="calibration"):
        decode(encode(scan(good.decode())).replace(good, text.encode()))


@pytest.mark.parametrize("version", [1, 2])
def test_a_store_of_an_earlier_version_is_read_and_upgraded_to_keep_calibration_identifiers(tmp_path, version):
    path = tmp_path / FILE_NAME
    with closing(open_for_writing(path)) as store:
        store.execute("INSERT INTO runs VALUES (1, 0, 'both', '0', 0, 'SIRTA', 48.7, 2.2, 156, '', '')")
        store.execute(RowConverter(Scan).insert, RowConverter(Scan).row(1, 0, scan("")))
        store.execute("ALTER TABLE scans DROP COLUMN calibration")
        if version == 1:
            for name in ("dni_est", "dhi_est", "albedo_est"):
                store.execute(f"ALTER TABLE decisions DROP COLUMN {name}")
        store.execute(f"PRAGMA user_version = {version}")
    assert export(tmp_path, tmp_path / "old", "csv", None, None, ["scans"]).rows == {"scans": 1}
    with closing(open_for_writing(path)) as store:
        assert store.execute("PRAGMA user_version").fetchone()[0] == VERSION
        identifier = calibration().identifier
        store.execute(RowConverter(Scan).insert, RowConverter(Scan).row(1, 1, scan(identifier, 1)))
    export(tmp_path, tmp_path / "new", "csv", None, None, ["scans"])
    assert [row["calibration"] for row in exported(tmp_path / "old")] == [""]
    assert [row["calibration"] for row in exported(tmp_path / "new")] == ["", identifier]
    assert exported(tmp_path / "new")[:1] == exported(tmp_path / "old")
    assert read_store(tmp_path, None, None).calibrations == {"", identifier}


def exported(folder):
    with (folder / "scans.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_fresh_store_is_of_the_newest_version(tmp_path):
    with closing(open_for_writing(tmp_path / FILE_NAME)):
        pass
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as store:
        assert store.execute("PRAGMA user_version").fetchone()[0] == VERSION
