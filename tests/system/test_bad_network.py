"""Cube and tracker over a bad network: what is lost, doubled, reordered and cut costs scans, and nothing else."""

import re
import time

import pytest

from tests.support.bad_network import BadNetwork, why_no_namespaces
from tests.system.processes import wait_until

pytestmark = pytest.mark.system

WATCHED_S = 4.0


@pytest.fixture(scope="module")
def _possible():
    why = why_no_namespaces()
    if why:
        pytest.skip(why)


def seen(network, *counted, **how):
    """Return the modes seen on a link that bad, over some seconds and until each counter in `counted` has risen."""
    network.change(**how)
    before, modes = network.state()["bridge"], set()
    end_s = time.monotonic() + WATCHED_S

    def told():
        state = network.state()
        modes.add(state["mode"]["name"])
        return time.monotonic() > end_s and all(state["bridge"][name] > before[name] for name in counted)

    wait_until(told, lambda: f"{counted} are not all counted: {network.log('tracker')}")
    return modes


@pytest.mark.usefixtures("_possible")
def test_the_tracker_survives_loss_duplicates_reordering_jitter_and_cuts_of_its_network(tmp_path):
    with BadNetwork(tmp_path, seed=5) as network:
        network.start("tracker")
        network.start("cube")
        network.until_mode("tracking")

        modes = seen(network, "accepted", "lost", loss=0.3)
        assert modes == {"tracking"}, network.log("tracker")

        out_of_order = {"duplicate": 0.5, "reorder": 0.3, "delay_s": 0.02, "jitter_s": 0.2}
        modes = seen(network, "accepted", "refused", loss=0.0, **out_of_order)
        assert modes == {"tracking"}, network.log("tracker")
        wait_until(lambda: "duplicate: a datagram from 10.77.0.1" in network.log("tracker"), "a duplicate is not told")

        network.change(duplicate=0.0, reorder=0.0, delay_s=0.0, jitter_s=0.0, cut=True)
        # About five of the service's scan intervals.
        time.sleep(0.6)
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
