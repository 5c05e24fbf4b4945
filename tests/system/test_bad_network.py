"""Cube and tracker over a bad network: what is lost, doubled, reordered and cut costs scans, and nothing else."""

import re
import time

import pytest

from tests.support.bad_network import BadNetwork, without_namespaces

pytestmark = pytest.mark.system

WATCHED_S = 4.0


@pytest.fixture(scope="module")
def _possible():
    why = without_namespaces()
    if why:
        pytest.skip(why)


def changed(network, **how):
    """Return what the bridge has counted, by name, while the link was as bad as that, and the modes that were seen."""
    network.change(**how)
    before, modes = network.state(), set()
    end_s = time.monotonic() + WATCHED_S
    while time.monotonic() < end_s:
        time.sleep(0.4)
        after = network.state()
        modes.add(after["mode"]["name"])
    counts = ("accepted", "lost", "refused")
    return {name: after["bridge"][name] - before["bridge"][name] for name in counts}, modes


@pytest.mark.usefixtures("_possible")
def test_loss_duplicates_reordering_jitter_and_cuts_between_cube_and_tracker(tmp_path):
    with BadNetwork(tmp_path, seed=5) as network:
        network.start("tracker")
        network.start("cube")
        network.until_mode("tracking")

        counts, modes = changed(network, loss=0.3)
        assert modes == {"tracking"}, network.log("tracker")
        assert counts["accepted"] > counts["lost"] > 0

        counts, modes = changed(network, loss=0.0, duplicate=0.5, reorder=0.3, delay_s=0.02, jitter_s=0.2)
        assert modes == {"tracking"}, network.log("tracker")
        assert counts["accepted"] > 0
        assert counts["refused"] > 0
        assert "duplicate: a datagram from 10.77.0.1" in network.log("tracker")

        network.change(duplicate=0.0, reorder=0.0, delay_s=0.0, jitter_s=0.0, cut=True)
        # 10 s of the service's time.
        time.sleep(0.5)
        network.change(cut=False)
        assert network.state()["mode"]["name"] == "tracking"

        network.change(cut=True)
        network.until_mode("fallback")
        network.change(cut=False)
        network.until_mode("tracking")

        # One address fills its own share of the API's connections, and nobody else's.
        assert 0 < network.connections_kept(60) <= 32
        assert "too many connections that send nothing from 10.77.0.1" in network.log("tracker")
        assert network.state()["mode"]["name"] == "tracking"

        assert network.stop() == {"tracker": 0, "cube": 0}
        log = network.log("tracker")
        assert "Traceback" not in log + network.log("cube")
        assert not re.search(r"forged|malformed|replayed|second cube", log)
