"""The service does what docs/mqtt.md says."""

import re

import pytest

from daemon.mqtt import telemetry
from daemon.service.operator_commands import COMMAND_NAMES
from daemon.store.tables import COLUMNS
from tests.support import DOCS

PAGE = (DOCS / "mqtt.md").read_text(encoding="utf-8")
ROWS = dict(re.findall(r"(?m)^\| `(\w+)` \| .* \| (\d \| \w+) \| [^|]* \|$", PAGE))


@pytest.mark.parametrize("kind", sorted(telemetry._MANNERS))
def test_docs_mqtt_md_has_a_row_with_the_right_qos_and_retain_for_each_record(kind):
    qos, retain = telemetry._MANNERS[kind]
    assert ROWS[kind] == f"{qos} | {'yes' if retain else 'no'}"


def test_docs_mqtt_md_names_all_topics_and_no_others():
    kinds = {name.removesuffix("s") for name, _ in COLUMNS.values()}
    assert set(telemetry._MANNERS) == kinds
    assert set(ROWS) == kinds | {"status", "state", "reply", "records"}
    assert set(re.findall(r"\| `command/(\w+)` \|", PAGE)) == set(COMMAND_NAMES)
