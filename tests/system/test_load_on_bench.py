"""The electronic load behind its real driver: what is stored is what the module gives, whatever happens to the load."""

import csv
import signal
import statistics
import time

import pytest

from tests.support import forks
from tests.system.processes import Process, wait_until
from tests.system.rig import HIGH_SUN, Rig, brisk

pytestmark = pytest.mark.system

MAKES = ["chroma63600", "agilent6063b"]


def start(tmp_path, start_bench, start_service, make):
    """Start a bench with a load of that make and a service that keeps its records."""
    config = brisk(tmp_path)
    config.write_text(
        config.read_text()
        + f'\n[load]\ndriver = "{make}"\nperiod_s = 2.0\n\n[store]\ndirectory = "records"\nbatch_s = 0.5\n'
    )
    bench = start_bench("--config", config, *HIGH_SUN)
    return Rig(bench, start_service(bench.config))


def stored(rig, tmp_path):
    """Return the curves in the store."""
    out = tmp_path / f"out{time.monotonic_ns()}"
    forks.run("export", "--config", rig.bench.config, "--out", out, "--kind", "curves").check_returncode()
    with (out / "curves.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def steady(rig):
    """Return the module's values if they have stayed the same for five curves, or None."""
    before, count = rig.bench.state()["load"]["truth"], sweeps(rig)
    wait_until(lambda: sweeps(rig) >= count + 5, rig.service.log)
    after = rig.bench.state()["load"]["truth"]
    return after if after["pmpp_w"] == pytest.approx(before["pmpp_w"], rel=0.005) else None


def sweeps(rig):
    return rig.bench.state()["load"]["sweeps"]


@pytest.mark.parametrize("make", MAKES)
def test_stored_iv_curves_agree_with_the_true_values_of_the_module(tmp_path, start_bench, start_service, make):
    rig = start(tmp_path, start_bench, start_service, make)
    rig.settle()
    truth = wait_until(lambda: steady(rig), rig.service.log)
    assert rig.service.stop() == 0
    state = rig.bench.state()["load"]
    assert not state["input_on"]
    assert not state["in_use"]
    curves = stored(rig, tmp_path)
    # On a busy machine a voltage may be read before the simulated load has set it, or no scan may be fresh: so of a few
    # curves one may be off, or without irradiance.
    good = [curve for curve in curves[-5:] if curve["quality"] == "ok"]
    assert len(good) >= 3

    def median(name):
        return statistics.median(float(curve[name]) for curve in good if curve[name])

    # The tolerances allow for noise of 0.1 % in the readings, and for a sun that moves.
    assert median("pmpp_w") == pytest.approx(truth["pmpp_w"], rel=0.01)
    assert median("voc_v") == pytest.approx(truth["voc_v"], rel=0.005)
    if make == "chroma63600":
        # The other load is rated 10 A, and the sun is bright.
        assert median("isc_a") == pytest.approx(truth["isc_a"], rel=0.01)
    assert median("zenith_start_w_m2") == pytest.approx(rig.bench.state()["sky"]["ghi_w_m2"], rel=0.1)


def test_an_unplugged_load_is_reported_once_and_does_not_disturb_tracking(tmp_path, start_bench, start_service):
    rig = start(tmp_path, start_bench, start_service, "chroma63600")
    rig.settle()
    rig.bench.ask("unplug", "load")
    wait_until(lambda: rig.lines("the load is down") == 1, rig.service.log)
    rig.new_sky()
    rig.settle()
    assert rig.last_mode() == "tracking"
    assert rig.lines(" is down: ") == 1, rig.service.log()
    count = sweeps(rig)
    rig.bench.ask("replug", "load")
    wait_until(lambda: rig.lines("the load is back") == 1 and sweeps(rig) > count, rig.service.log)
    assert rig.lines("the load is down") == 1, rig.service.log()


@pytest.mark.long
def test_the_service_survives_a_hanging_load_a_tripped_load_and_another_instrument_in_its_place(
    tmp_path, start_bench, start_service
):
    rig = start(tmp_path, start_bench, start_service, "agilent6063b")
    wait_until(lambda: sweeps(rig) >= 1, rig.service.log)
    for make_trouble, end_it in (
        (("freeze", "load"), ("thaw", "load")),
        (("delay", "load", 3), ("delay", "load", 0)),
        (("drop", "load", 1), None),
        (("power-cycle", "load"), None),
        (("trip", "over-temperature"), None),
    ):
        rig.bench.ask(*make_trouble)
        if end_it is not None:
            time.sleep(2.0)
            rig.bench.ask(*end_it)
        count = sweeps(rig)
        wait_until(lambda before=count: sweeps(rig) >= before + 2, rig.service.log)
    rig.bench.ask("identity", "load", "SOMETHING,ELSE,0,0")
    down = rig.lines("the load is down")
    rig.bench.ask("unplug", "load", 1)
    wait_until(lambda: rig.lines("the load is down") > down, rig.service.log)
    count = sweeps(rig)
    time.sleep(4.0)
    assert sweeps(rig) == count
    rig.bench.ask("identity", "load", "HEWLETT-PACKARD,6063B,0,A.02.01")
    wait_until(lambda: sweeps(rig) > count, rig.service.log)
    assert rig.service.exit_code is None


def test_after_a_kill_in_the_middle_of_an_iv_curve_the_next_service_switches_the_load_off(
    tmp_path, start_bench, start_service
):
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    killed = Process(["run", "--config", bench.config], tmp_path / "killed.log")
    wait_until(lambda: bench.state()["load"]["input_on"], killed.log)
    assert killed.stop(signal.SIGKILL) == -signal.SIGKILL
    assert bench.state()["load"]["input_on"]
    follower = start_service(bench.config)
    wait_until(lambda: not bench.state()["load"]["input_on"], follower.log)
    assert follower.stop() == 0
    assert not bench.state()["load"]["input_on"]
