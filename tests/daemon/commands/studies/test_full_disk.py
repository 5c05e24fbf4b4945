"""Pictures and tables of the studies on a full disk."""

import pytest

from tests.daemon.commands.studies.test_calibrate import beside

pytestmark = pytest.mark.slow

SITE = ("--site", "48.7,2.2,156")


@pytest.fixture
def inputs(tmp_path):
    """Half an hour of weather, a site with it, two trackers that lie flat, and a cube beside a reference."""
    minutes = range(600, 630)
    clock = [f"2016-06-05T{minute // 60:02d}:{minute % 60:02d}:00Z" for minute in minutes]
    lines = {
        "weather.csv": ["time,ghi,dni,dhi", *(f"{at},{400 + 5 * place},300,150" for place, at in enumerate(clock))],
        "sites.csv": ["name,latitude,longitude,altitude,weather", "here,48.7,2.2,156,weather.csv"],
        "flat.csv": ["time,tracker,pmpp_w,a_deg,b_deg"],
    }
    for second in range(0, 3600, 5):
        at = f"2022-10-12T10:{second // 60:02d}:{second % 60:02d}"
        lines["flat.csv"] += [f"{at}.0Z,T-Cube,{48 + second / 30},0,90", f"{at}.5Z,T-Chrono,{50 + second / 30},0,90"]
    for name, each in lines.items():
        (tmp_path / name).write_text("\n".join(each) + "\n")
    faces = [f"{at},220,300,210,{510 + place}" for place, at in enumerate(clock)]
    (tmp_path / "faces.csv").write_text("\n".join(["time,east,south,west,zenith", *faces, ""]))
    beside(tmp_path, days=1)


@pytest.fixture
def study(heliocube, inputs, tmp_path, monkeypatch):
    """Runs a study in the folder of its inputs; returns its exit code and its error text."""
    monkeypatch.chdir(tmp_path)

    def run(words):
        no_site = words.startswith(("gain", "compare fit", "energy --sites"))
        code, _, told = heliocube(*words.split(), "--force", *(() if no_site else SITE))
        return code, told

    return run


@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("gain --lat 48 --plot FILE", "gain.png"),
        ("gain --lat 48 --plot FILE", "gain.svg"),
        ("gain --lat 48 --plot FILE", "gain.pdf"),
        ("gain --lat 48 --format csv --out FILE", "gain.csv"),
        ("gain --lat 48 --format parquet --out FILE", "gain.parquet"),
        ("energy weather.csv --laws flat --out .", "energy.csv"),
        ("energy weather.csv --laws flat --out .", "energy.png"),
        ("energy weather.csv --laws optimal --losses --out .", "energy-losses.png"),
        ("energy --sites sites.csv --laws flat --out .", "energy-sites.csv"),
        ("energy --sites sites.csv --laws flat --out .", "energy-sites.png"),
        ("calibrate cube reference.csv sensors.csv --lag 0 --plot FILE", "beside.png"),
        ("compare fit flat.csv --out bias.json", "bias.json"),
        ("compare fit flat.csv --out bias.json", "bias.png"),
        ("compare fit flat.csv --out bias.json", "bias.svg"),
        ("compare report flat.csv --out .", "gains.csv"),
        ("compare report flat.csv --out .", "power-2022-10-12.png"),
        ("replay faces.csv --out FILE", "replay.csv"),
        ("replay faces.csv --out FILE", "replay.csv.gz"),
    ],
)
def test_a_file_of_a_study_keeps_its_earlier_content_when_the_disk_is_full(study, tmp_path, words, file):
    (tmp_path / file).write_text("of yesterday")
    part = tmp_path / f".{file}.part"
    part.symlink_to("/dev/full")
    code, told = study(words.replace("FILE", file))
    assert code == 2
    assert told.endswith(": No space left on device\n")
    assert (tmp_path / file).read_text() == "of yesterday"
    assert not part.is_symlink()
