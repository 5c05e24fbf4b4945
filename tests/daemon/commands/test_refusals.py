"""Mistakes on the command line are refused before anything is loaded that only the work needs."""

import json
import os
import subprocess
import sys

import pytest

from tests.support import PATIENCE_S

# Loading each takes half a second on a quick machine, several on a Raspberry Pi.
HEAVY = ("matplotlib", "pandas", "pvlib", "pyarrow", "scipy")
IN_ONE_PROCESS = """
import contextlib, functools, io, json, sys
import typer.main
from daemon.commands.main import main
# Built anew for each of them, alike each time, the commands take half of the time.
typer.main.get_command = functools.cache(typer.main.get_command)
found = []
for words in json.load(sys.stdin):
    sys.argv, told = ["heliocube", *words], io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
        main()
    found.append([words, told.getvalue(), sorted(set(HEAVY) & set(sys.modules))])
print(json.dumps(found))
"""
THERE = "is there already: --force overwrites it, or name another "
LONG = "x" * 300
WRONG = {
    f"gain --lat 48 --weather {LONG}": f"{LONG} cannot be used: File name too long; name another place",
    f"gain --lat 48 --format csv --out {LONG}": f"{LONG} cannot be used: File name too long; name another place",
    "run --site 48,2 --site 55,12": "nothing is done: --site is given 2 times, and only one would count",
    "gain --lat 48 --weather clear --weather file": "--weather is given 2 times, and only one would count",
    "gain --lat 48 --lat 52 --lat 55": "--lat is given 3 times",
    "energy file --site 48,2 --out new --laws flat --laws optimal": "--laws is given 2 times",
    "report --store there --store new --day yesterday --out new": "--store is given 2 times",
    "run --weather nonsense": "no weather file at nonsense, and it is not one of the built-in skies clear",
    "run --law nonsense": "nonsense",
    "run --site 100,200": "not on Earth",
    "energy file --site 4_8,2 --out new": "'4_8,2' is not LAT,LON",
    "energy file --site 48,2 --out new --laws fixed:3_5": "there is no law 'fixed:3_5'",
    "run --start noon": "'noon' is not a date or time",
    "run --config none.toml": "there is no such file",
    "simulate --out new --start noon": "'noon' is not a date or time",
    "simulate --out new --start 2022-10-12 --weather nonsense": "no weather file at nonsense",
    "simulate --out new --start 2022-10-12 --law nonsense": "nonsense",
    "simulate --out file --start 2022-10-12": "--out: file cannot be a folder",
    "simulate --out there --start 2022-10-12": "there/scans.csv " + THERE + "--out",
    "replay none.csv --out new.csv --site 48,2": "there is no file none.csv",
    "replay file --out new.csv --site 48": "'48' is not LAT,LON",
    "replay file --out new.parquet --site 48,2": "--out: new.parquet must end in .csv or .csv.gz",
    "replay file --out new.gz --site 48,2": "--out: new.gz must end in .csv or .csv.gz",
    "replay file --out there/out.csv --site 48,2": "there/out.csv " + THERE + "--out",
    "simulate --out new --start 2022-10-12 --weather there": "there is a folder: name a file with measured weather in",
    "energy none.csv --site 48,2 --out new": "there is no weather file at none.csv: name a file of measured weather",
    "energy clear --site 48,2 --out new": "clear is a built-in sky that this command does not take: name a file of",
    "gain --lat 48 --weather overcast": "that this command does not take: name a file of measured weather or clear",
    "energy file --site 48 --out new": "'48' is not LAT,LON",
    "energy file --site 48,2 --out new --laws none": "there is no law 'none'",
    "energy file --site 48,2 --out new --sky none": "there is no sky 'none'",
    "energy file --site 48,2 --out there": "there/energy.txt " + THERE + "--out",
    "gain --lat 48 --format csv --out there/out.csv": "there/out.csv " + THERE + "--out",
    "gain --lat 48 --plot there/out.png": "there/out.png " + THERE + "--plot",
    "compare simulate --start 2022-10-12 --out there": "there/powers.csv " + THERE + "--out",
    "compare simulate --start 2022-10-12 --out new --weather none": "there is no weather file at none",
    "compare fit a.csv --out there/out.csv": "there/out.csv " + THERE + "--out",
    "compare report a.csv --out there": "there/gains.csv " + THERE + "--out",
    "compare fit a.csv --out .": "--out: . is a folder: name a file in it",
    "compare fit none.csv --out new.json": "there is no file none.csv with measured powers",
    "compare report file --out new --period fog": "--period: 'fog' is not NAME=FROM/TO",
    "compare report file --out new --cube A --chrono A": "--cube and --chrono both name 'A'",
    "compare paper --out new --law none": "--law: there is no 'none'",
    "gain --lat 48 --weather none.csv": "there is no weather file at none.csv: name a file of measured weather",
    "plot light --store there --out new.png": "name either --day DAY, or --from and --to",
    "calibrate cube none.csv none.csv --site 48,2": "there is no file none.csv with readings",
    "calibrate field none.csv --site 48,2": "there is no file none.csv with readings",
    "samples --out file": "--out: file cannot be a folder",
    "plot light --store none --day 2022-10-12 --out new.png": "there is no store at none/heliocube.sqlite",
    "simulate --out new --start 2022-10-12 --report new --zone nowhere": "there is no time zone 'nowhere'",
    "simulate --out new --start 2022-10-12 --plot new.png --zone nowhere": "there is no time zone 'nowhere'",
    "simulate --out new --start 2022-10-12 --zone nowhere": "there is no time zone 'nowhere'",
    "stop t2": "nothing is done: 'stop' takes no name; for one of several trackers add --tracker t2",
    "gain --lat 48 --plot new.gif": "--plot: new.gif must end in .png",
    "campaign --only nothing": "--only: there is no nothing; faults are",
    "campaign --without nothing": "--without: there is no fault or command nothing",
    "campaign --schedule none.json": "--schedule: none.json cannot be read: No such file",
    "campaign --reliability new.md --only sensor --seeds 3": "own way, so --seeds and --only would do nothing: leave",
    "campaign --reliability new.md --schedule file": "--reliability tries every fault in its own way, so --schedule",
    "campaign --schedule file --hours 3": "--schedule has its own faults and hours, so --hours would do nothing: leave",
    "campaign --cluster nowhere": "--cluster: 'nowhere' is not an address",
    "replay there --out new.csv --site 48,2": "there is a folder: name a file with a cube's readings in it",
    "replay pipe --out new.csv --site 48,2": "pipe is no ordinary file: write its records into one and name that",
    "compare fit there --out new.json": "there is a folder: name a file with measured powers in it",
    "compare report pipe --out new": "pipe is no ordinary file: write its records into one and name that",
    "calibrate cube there file --site 48,2": "there is a folder: name a file with readings in it",
    "calibrate field pipe --site 48,2": "pipe is no ordinary file: write its records into one and name that",
    "simulate --out new --start 2022-10-12 --weather pipe": "pipe is no ordinary file: write its records into one",
    "bridge send-csv /dev/zero --insecure --to 127.0.0.1:9": "/dev/zero is no ordinary file: write its records",
    "energy --sites /dev/zero --out new": "/dev/zero is no ordinary file: write its records into one and name that",
    "campaign --schedule pipe": "pipe is no ordinary file: write its records into one and name that",
    "bench --dir file": "--dir: file cannot be a folder: file is a file",
    "bench-ctl none fail -201003": "no bench answers there (No such file or directory); start one",
    "energy --sites none.csv --out new": "--sites: none.csv cannot be read: No such file",
    "plot nothing --store there --out new.png": "there is no picture 'nothing'; choose from light",
    "plot light --tables none --out new.png": "none has neither scans.csv nor scans.parquet",
    "report --store none --day 2022-10-12 --out new": "there is no store at none/heliocube.sqlite",
    "compare paper --out there": "there/paper.txt " + THERE + "--out",
    "campaign --from 3 --seeds 2 --keep there": "there/seed-4.json " + THERE + "--keep",
    "campaign --reliability there/out.csv": "there/out.csv " + THERE + "--reliability",
    "bench --dir new --weather nonsense": "no weather file at nonsense",
    "report --store there": "name either --day DAY, or --from and --to",
    "setup /": "/ is a folder: name the file to write, such as /heliocube.toml",
    "run --start 9998-12-31T23:59": "must be in the years 1979 to 2099",
    "notify --config home.toml": "people_file = '~nosuch/x': there is no such user; write the whole path",
    "archive --config home.toml": "password_file = '~nosuch/x': there is no such user; write the whole path",
    "notify --config deep.toml": "deep.toml is not TOML: its brackets are nested too deeply",
    "dashboard --config deep.toml": "deep.toml is not TOML: its brackets are nested too deeply",
    "config check sky.toml": "simulation.weather: there is no weather file at ",
    "config init file": "file is the name of a file: name the folder that heliocube.toml is to be in",
    "bridge send-csv file": "name the key with --key FILE or --config FILE",
    "gain --points none.csv": "there is no points file at none.csv",
    "gain --points file": "points file file has no column phi_deg; found: mine",
    "gain": "give --lat or --lat-range, such as --lat 48.7 or --lat-range 0:65:1",
    "gain --lat 48 --day 400": "--day: 400 is not in 1..365",
    "export --out new": "export needs either --store DIR or --config FILE",
}


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    """What each of the commands says, and which modules it has loaded by then, by its words."""
    folder = tmp_path_factory.mktemp("refused")
    (folder / "file").write_text("mine")
    (folder / "home.toml").write_text(
        "[notify]\npeople_file = '~nosuch/x'\n[archive]\ndatabase = 'postgresql://u@h/d'\npassword_file = '~nosuch/x'\n"
    )
    (folder / "sky.toml").write_text("[simulation]\nweather = 'none.csv'\n")
    (folder / "deep.toml").write_text(f"a = {'[' * 5000}")
    (folder / "there").mkdir()
    os.mkfifo(folder / "pipe")
    names = ("scans.csv", "out.csv", "out.png", "energy.txt", "powers.csv", "gains.csv", "paper.txt", "seed-4.json")
    for name in names:
        (folder / "there" / name).write_text("mine")
    program = f"HEAVY = {HEAVY!r}\n{IN_ONE_PROCESS}"
    words = json.dumps([each.split() for each in WRONG])
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=words,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
        cwd=folder,
    )
    assert {path.read_text() for path in (folder / "there").iterdir()} == {"mine"}
    assert not (folder / "new").exists()
    return {" ".join(each): (told, heavy) for each, told, heavy in json.loads(done.stdout)}


@pytest.mark.parametrize("words", WRONG, ids=lambda words: words[:60])
def test_a_wrong_command_line_is_refused_in_a_sentence_before_heavy_modules_are_loaded(refused, words):
    told, heavy = refused[words]
    assert WRONG[words] in told
    assert told.startswith("heliocube: ")
    assert heavy == []
