"""A real scheduler with two workers on loopback: the same bytes as one process, although a worker is killed."""

import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.metadata import distribution, version

import pytest

from daemon.base.errors import ExitCode, UserError
from daemon.studies.spread.workers import Workers, gather
from tests.support import PATIENCE_S, ROOT, forks
from tests.system.processes import wait_until

pytestmark = [
    pytest.mark.system,
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="the extra 'cluster' is not installed"),
]

PROGRESS = re.compile(r"comparing: \d+ % done after \d+ min(, about \d+ min left)?")
SITES = 6
# Work that one worker has been handed stays there, even if another is idle.
KEEPS = {"DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING": "False"}


def begin(module, *words, log):
    command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words), "--no-dashboard"]
    with log.open("w") as output:
        return subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT, env=os.environ | KEEPS)


@pytest.fixture
def cluster(tmp_path):
    told = tmp_path / "scheduler.json"
    words = ("--host", "127.0.0.1", "--port", 0, "--scheduler-file", told)
    running = [begin("dask_scheduler", *words, log=tmp_path / "scheduler.log")]
    words = ("--nworkers", 2, "--nthreads", 1, "--scheduler-file", told, "--local-directory", tmp_path)
    running.append(begin("dask_worker", "--host", "127.0.0.1", *words, log=tmp_path / "workers.log"))
    try:
        yield json.loads(wait_until(lambda: told.exists() and told.read_text(), "the address"))["address"]
    finally:
        for process in reversed(running):
            process.terminate()
        for process in reversed(running):
            process.communicate(timeout=PATIENCE_S)


def energy(table, out, *words):
    return ["energy", "--sites", table, "--out", out, "--laws", "flat,mu-prime", *words]


@pytest.fixture
def table(tmp_path):
    weather = ["time,ghi,dni,dhi"]
    for at in range(1440):
        dni = at % 700 if 360 < at < 960 else 0
        weather.append(f"2016-06-05T{at // 60:02d}:{at % 60:02d}:00Z,{150 + dni / 2},{dni},150")
    (tmp_path / "day.csv").write_text("\n".join(weather))
    lines = [f"site {number},{number},12,day.csv" for number in range(SITES)]
    path = tmp_path / "sites.csv"
    path.write_text("\n".join(["name,latitude,longitude,weather", *lines]))
    return path


def test_a_cluster_writes_the_same_bytes_although_a_worker_is_killed(cluster, table, tmp_path):
    distributed = importlib.import_module("distributed")
    with distributed.Client(cluster, timeout=PATIENCE_S, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=PATIENCE_S)
        busy, pid = next(iter(client.run(os.getpid).items()))
        asleep = client.submit(time.sleep, PATIENCE_S, workers=[busy])
        wait_until(lambda: asleep.key in client.processing()[busy], "a busy worker")
        with (tmp_path / "said").open("wb") as said, (tmp_path / "told").open("wb") as told:
            study = forks.start(energy(table, tmp_path / "far", "--cluster", cluster), said, told)
        # The busy worker has a share of the study behind the sleeping task; without that share the study cannot end.
        wait_until(lambda: len(client.processing()[busy]) > 1, "work for the busy worker")
        assert study.poll() is None
        os.kill(pid, signal.SIGKILL)
        assert study.wait(PATIENCE_S) == 0, (tmp_path / "told").read_text()
    here = forks.run(*energy(table, tmp_path / "here"))
    said = (tmp_path / "said").read_text().replace(str(tmp_path / "far"), str(tmp_path / "here"))
    assert here.stdout == said
    # A study that takes longer than a minute says how far it is.
    warnings = [
        [line for line in text.splitlines() if not PROGRESS.fullmatch(line)]
        for text in (here.stderr, (tmp_path / "told").read_text())
    ]
    assert warnings[0] == warnings[1]
    assert len(warnings[0]) == SITES
    for ending in ("txt", "csv", "png"):
        name = f"energy-sites.{ending}"
        assert (tmp_path / "far" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
    assert (tmp_path / "far" / "energy-sites.csv").read_text().count("mu-prime") == SITES
    another_release_is_refused(cluster, table, tmp_path)


def another_release_is_refused(address, table, tmp_path):
    """Workers are asked for their release before they get work; one without heliocube is refused too."""
    known = tmp_path / "heliocube-9.9.dist-info"
    known.mkdir()
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: heliocube\nVersion: 9.9\n")
    (known / "entry_points.txt").write_text(distribution("heliocube").read_text("entry_points.txt"))
    study = forks.run(
        *energy(table, tmp_path / "never", "--cluster", address), env=os.environ | {"PYTHONPATH": str(tmp_path)}
    )
    errors = study.stderr
    assert study.returncode == ExitCode.UNREACHABLE, errors
    both = f"has heliocube {version('heliocube')}, and this machine uses 9.9"
    assert re.fullmatch(rf"heliocube: --cluster: the worker at tcp://\S+ {re.escape(both)}: [^\n]+\n", errors)


def test_an_invalid_cluster_address_is_refused_as_mistyped():
    with pytest.raises(UserError, match=r"'nonsense' is not an address, such as 192\.168\.1\.5:8786") as raised:
        gather(abs, [1], Workers(cluster="nonsense"), lambda _share: None)
    assert raised.value.exit_code is ExitCode.MISTYPED
