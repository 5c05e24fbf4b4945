"""The service does what docs/mqtt.md says."""

import re

import pytest

from daemon.mqtt import telemetry
from daemon.service.operator_commands import NAMES
from daemon.store.tables import COLUMNS
from tests.support import DOCS

PAGE = (DOCS / "mqtt.md").read_text(encoding="utf-8")
ROWS = dict(re.findall(r"(?m)^\| `(\w+)` \| .* \| (\d \| \w+) \| [^|]* \|$", PAGE))


@pytest.mark.parametrize("kind", sorted(telemetry._MANNERS))
def test_each_record_has_its_row_with_quality_of_service_and_retain(kind):
    qos, retain = telemetry._MANNERS[kind]
    assert ROWS[kind] == f"{qos} | {'yes' if retain else 'no'}"


def test_no_topic_is_left_out_and_none_is_named_that_is_not_there():
    kinds = {name.removesuffix("s") for name, _ in COLUMNS.values()}
    assert set(telemetry._MANNERS) == kinds
    assert set(ROWS) == kinds | {"status", "state", "reply", "records"}
    assert set(re.findall(r"\| `command/(\w+)` \|", PAGE)) == set(NAMES)
