"""The list of alarms, compared with the source and the page."""

import ast
import importlib.util

import pytest

from daemon.base.alarms.kinds import KINDS, Severity, kind_of_alarm, with_tracker_option
from tests.support import DOCS, ROOT


def raised_in_the_source():
    """Return the names that are raised anywhere: literals, or a module's constant."""
    found = set()
    for path in (ROOT / "daemon").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = {
            target.id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Call)
                and ast.unparse(node.func).endswith(("larms.set", "self._alarm"))
                and node.args
            ):
                name = node.args[0]
                found.add(name.value if isinstance(name, ast.Constant) else constants.get(ast.unparse(name)))
    return found - {None}


def test_every_alarm_that_is_raised_is_in_the_list_and_no_other():
    assert raised_in_the_source() == set(KINDS)


def test_each_alarm_kind_states_cause_effect_and_remedy_without_a_full_stop():
    for kind in KINDS.values():
        for text in (kind.cause, kind.effect, kind.remedy):
            assert text, kind.name
            assert not text.endswith("."), kind.name


def test_an_alarm_that_is_not_in_the_list_counts_as_a_warning():
    assert kind_of_alarm("somebody-elses").severity is Severity.WARNING


def test_the_alarms_page_in_docs_is_current():
    specification = importlib.util.spec_from_file_location("alarms_table", DOCS / "alarms_table.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    assert module.PAGE.read_text(encoding="utf-8") == module.page(), "run: python docs/alarms_table.py"
    assert all(f"| `{name}` |" in module.table() for name in KINDS)


@pytest.mark.parametrize(
    ("text", "typed"),
    [
        (
            "`heliocube clear`, or `heliocube home`",
            "`heliocube clear --tracker east`, or `heliocube home --tracker east`",
        ),
        ("'heliocube alarms ack move-failed'", "'heliocube alarms ack move-failed --tracker east'"),
        ("'heliocube stop' ends it", "'heliocube stop --tracker east' ends it"),
        ("'heliocube auto --tracker east' ends it", "'heliocube auto --tracker east' ends it"),
        (
            "see 'heliocube status' and 'heliocube store salvage'",
            "see 'heliocube status' and 'heliocube store salvage'",
        ),
    ],
)
def test_commands_named_in_alarm_texts_get_the_tracker_option_where_there_are_several_trackers(text, typed):
    assert with_tracker_option(text, "east") == typed
    assert with_tracker_option(text, None) == text
