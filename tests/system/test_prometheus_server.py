"""Prometheus itself, with the configuration and the rules of deploy/, scrapes a service of two trackers."""

import json
import shutil
import subprocess
import urllib.parse
import urllib.request

import pytest

from tests.daemon.api.test_prometheus import RULES, expressions
from tests.support.addresses import free_port
from tests.system.processes import wait_until

PROMETHEUS = shutil.which("prometheus")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(PROMETHEUS is None, reason="prometheus is not installed"),
]

# So early in the day that both angles differ from those of the night.
RIG = """
[simulation]
speed = 30.0
weather = "clear"
start_utc = 2022-06-21T08:00:00Z
[law]
driver = "chronometric"
[bridge]
listen = "127.0.0.1:0"
[[tracker]]
name = "roof"
load.driver = "simulated"
[[tracker]]
name = "yard"
"""
ONLY_AT_TIMES = {"Alarms"}


@pytest.fixture
def prometheus(tmp_path, start_service):
    """Return a function that asks a Prometheus, which scrapes a service on the simulated rig every second."""
    service, own = free_port(), free_port()
    config = tmp_path / "heliocube.toml"
    config.write_text(f"{RIG}[api]\nlisten = '127.0.0.1:{service}'\n")
    start_service(config)
    for rules in RULES.glob("*.rules.yml"):
        shutil.copy(rules, tmp_path)
    example = (RULES / "prometheus.example.yml").read_text()
    assert "127.0.0.1:20572" in example
    (tmp_path / "prometheus.yml").write_text(example.replace("20572", str(service)).replace("15s", "1s"))
    arguments = (
        f"--config.file={tmp_path / 'prometheus.yml'}",
        f"--storage.tsdb.path={tmp_path / 'series'}",
        f"--web.listen-address=127.0.0.1:{own}",
    )
    with (tmp_path / "prometheus.log").open("w") as log:
        process = subprocess.Popen([PROMETHEUS, *arguments], stdout=log, stderr=log)

    def ask(path, **query):
        address = f"http://127.0.0.1:{own}/api/v1/{path}?{urllib.parse.urlencode(query)}"
        try:
            with urllib.request.urlopen(address) as answer:
                return json.load(answer)["data"]
        except OSError:
            assert process.poll() is None, (tmp_path / "prometheus.log").read_text()
            return None

    yield ask
    process.terminate()
    process.wait()


def test_prometheus_scrapes_the_service_evaluates_each_rule_and_has_data_for_each_panel(prometheus):
    def targets():
        known = prometheus("targets") or {}
        return [(target["health"], target["lastError"]) for target in known.get("activeTargets", [])]

    def failed():
        rules = [rule for group in prometheus("rules")["groups"] for rule in group["rules"]]
        return {rule["name"]: rule.get("lastError") for rule in rules if rule["health"] == "err"}

    def series(expression):
        return prometheus("query", query=expression.replace("$instance", ".*").replace("$tracker", ".*"))["result"]

    def empty():
        return [panel for panel, text in expressions() if panel not in ONLY_AT_TIMES and not series(text)]

    wait_until(lambda: targets() == [("up", "")], targets)
    wait_until(lambda: failed() or not empty(), empty)
    assert failed() == {}
    assert {one["metric"]["tracker"] for one in series('heliocube_angle_degrees{axis="a"}')} == {"roof", "yard"}
