import re

import pytest
from typer.main import get_command

from daemon.base.records import Mode, MoveOutcome, Quality
from daemon.bridge.refusals import Refusal
from daemon.commands.main import app
from tests.support import ROOT

PAGE = (ROOT / "docs" / "operate.md").read_text(encoding="utf-8")
METRICS = (ROOT / "daemon" / "api" / "metrics.py").read_text(encoding="utf-8")
COUNTED = re.findall(r'found\.count\(\s*"(\w+)"', METRICS)
MEASURED = re.findall(r'(?:found\.(?:gauge|by_axis)\(\s*"|HistogramMetricFamily\("heliocube_)(\w+)"', METRICS)


@pytest.mark.parametrize("name", [*Mode, *MoveOutcome, *Refusal, *(q for q in Quality if q is not Quality.OK)])
def test_every_mode_outcome_refusal_and_quality_is_explained_in_the_operating_docs(name):
    assert f"`{name}`" in PAGE


@pytest.mark.parametrize("name", [*(f"{name}_total" for name in COUNTED), *MEASURED])
def test_every_metric_is_explained_in_the_operating_docs(name):
    assert f"`heliocube_{name}`" in PAGE


def test_the_operating_docs_explain_no_metric_that_does_not_exist():
    known = {f"{name}_total" for name in COUNTED} | set(MEASURED)
    assert set(re.findall(r"`heliocube_(\w+)`", PAGE)) == known


def test_the_operating_docs_name_no_command_that_does_not_exist():
    named = set(re.findall(r"heliocube ([a-z]+)(?= |`|\n)", re.sub(r"(?m)^heliocube .*", "", PAGE)))
    assert named - {"heliocube"} <= set(get_command(app).commands), named
