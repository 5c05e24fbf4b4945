"""What deploy/ gives to Prometheus and Grafana, read by Prometheus' own tool and compared with the metrics."""

import json
import re
import shutil
import subprocess

import pytest

from daemon.base.records import Mode
from tests.daemon.commands.test_operate import COUNTED, MEASURED
from tests.support import ROOT
from tests.support.api import serve
from tests.support.phases import wait_for_tracking

__all__ = ["serve"]

RULES = ROOT / "deploy" / "prometheus"
DASHBOARD = ROOT / "deploy" / "grafana" / "heliocube.json"
KNOWN = {f"heliocube_{name}_total" for name in COUNTED} | {f"heliocube_{name}" for name in MEASURED}
# A recorded series is named level:metric:operation.
RECORDED = re.compile(r"\w+:heliocube_\w+:\w+")
needs_promtool = pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")


def promtool(*arguments, **options):
    return subprocess.run(["promtool", *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def expressions():
    """Yield each panel's title and expression."""
    for panel in json.loads(DASHBOARD.read_text())["panels"]:
        for target in panel["targets"]:
            yield panel["title"], target["expr"]


@needs_promtool
@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "config", RULES / "prometheus.example.yml"),
        ("check", "rules", RULES / "recording.rules.yml", RULES / "alert.rules.yml"),
        ("test", "rules", RULES / "rules.test.yml"),
    ],
)
def test_promtool_accepts_the_prometheus_configuration_and_rules(arguments):
    done = promtool(*arguments)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


def test_every_alert_rule_occurs_in_the_rule_tests():
    alerts = re.findall(r"alert: (\w+)", (RULES / "alert.rules.yml").read_text())
    tried = (RULES / "rules.test.yml").read_text()
    assert len(alerts) > 10
    assert [name for name in alerts if not re.search(rf"\b{name}\b", tried)] == []


def test_rules_and_grafana_dashboard_use_only_metrics_that_the_service_has():
    texts = [path.read_text() for path in RULES.glob("*.rules.yml")] + [text for _, text in expressions()]
    recorded = set(re.findall(r"record: (\S+)", texts[0] + texts[1]))
    assert len(recorded) > 3
    for text in texts:
        assert set(RECORDED.findall(text)) <= recorded
        plain = set(re.findall(r"heliocube_\w+", RECORDED.sub("", text)))
        assert plain <= KNOWN


@needs_promtool
def test_every_expression_of_the_grafana_dashboard_is_valid_for_prometheus(tmp_path):
    rules = [
        {"record": f"a:b{number}", "expr": text.replace("$instance", ".*").replace("$tracker", ".*")}
        for number, (_, text) in enumerate(expressions())
    ]
    (tmp_path / "rules.yml").write_text(json.dumps({"groups": [{"name": "panels", "rules": rules}]}))
    done = promtool("check", "rules", tmp_path / "rules.yml")
    assert done.returncode == 0, done.stderr + done.stdout


def test_grafana_dashboard_has_a_place_per_panel_every_mode_and_no_fixed_data_source():
    dashboard = json.loads(DASHBOARD.read_text())
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)
    assert all(panel["datasource"]["uid"] == "${datasource}" for panel in panels)
    assert {variable["name"] for variable in dashboard["templating"]["list"]} == {"datasource", "instance", "tracker"}
    modes = panels[0]["fieldConfig"]["defaults"]["mappings"][0]["options"]
    assert {value["text"] for value in modes.values()} == set(Mode)
    assert all(f'mode="{mode}"' in panels[0]["targets"][0]["expr"] for mode in Mode)


@needs_promtool
def test_promtool_accepts_the_metrics_of_a_service_with_an_alarm(serve):
    async def scenario(rig, call_http):
        await wait_for_tracking(rig)
        rig.tracker.alarms.set("move-failed", "stalled")
        rig.service.cube_alarms.set("clock", "in doubt")
        text = (await call_http.get("/metrics")).body.decode()
        assert 'heliocube_alarms_unacknowledged{tracker="tracker"} 1.0' in text
        assert "heliocube_wind_meters_per_second{" in text
        assert f'heliocube_day_mode_seconds{{mode="{Mode.TRACKING}"' in text
        done = promtool("check", "metrics", input=text)
        assert (done.returncode, done.stderr) == (0, "")
        shown = set(re.findall(r"^(heliocube_\w+)[{ ]", text, re.MULTILINE))
        assert {name for name in shown if not name.startswith("heliocube_loop_late_seconds")} <= KNOWN

    serve(scenario)
