"""The worked example of docs/develop/add-stow-source.md, taken from the page."""

import logging
import math
import re
from types import ModuleType

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.state import StateFolder
from daemon.tracker.stow_watch import SafetyFile, StowWatch
from tests.support import DOCS

CALM_S = 600.0


class Clock:
    """A clock that a test sets."""

    now_s = 1000.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return 1665576000.0 + self.now_s


@pytest.fixture(scope="module")
def example():
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "develop" / "add-stow-source.md").read_text(), re.DOTALL)
    module = ModuleType("file_stow")
    exec(compile(code, "docs/develop/add-stow-source.md", "exec"), module.__dict__)
    return module


@pytest.fixture
def watch(example, tmp_path):
    """Start the watch, again after a restart: ``watch(clock)``, on `tmp_path`/warning."""

    def start(clock):
        source = example.FileStow(tmp_path / "warning", CALM_S)
        return StowWatch([source], SafetyFile(StateFolder(tmp_path)), clock, Alarms(clock, lambda _record: None))

    return start


def test_the_example_source_stows_while_the_file_warns_and_for_its_calm_time_after(watch, tmp_path):
    warning, clock = tmp_path / "warning", Clock()
    warning.write_text("clear\n")
    stow = watch(clock)
    assert stow.waiting_why(clock.now_s) == f"waiting for the first message of the warning in {warning}"
    assert stow.reasons(clock.now_s) == ()
    assert stow.waiting_why(clock.now_s) is None
    warning.write_text("hail\n")
    assert stow.reasons(clock.now_s) == (f"{warning} says 'hail'",)
    warning.write_text("clear\n")
    assert stow.reasons(clock.now_s + CALM_S - 1) == (f"{warning} says 'hail'",)
    assert stow.statuses(clock.now_s + CALM_S - 1)[0].release_in_s == pytest.approx(1.0)
    assert stow.reasons(clock.now_s + CALM_S) == ()


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b""])
def test_a_missing_empty_or_undecodable_warning_file_causes_a_stow(watch, tmp_path, content):
    if content is not None:
        (tmp_path / "warning").write_bytes(content)
    clock = Clock()
    assert watch(clock).reasons(clock.now_s)


def test_a_warning_file_that_was_never_read_has_an_infinite_age(watch):
    clock = Clock()
    stow = watch(clock)
    assert stow.reasons(clock.now_s)
    assert stow.statuses(clock.now_s)[0].age_s == math.inf


def test_a_stow_warning_outlasts_a_restart_for_its_calm_time(watch, tmp_path, caplog):
    caplog.set_level(logging.ERROR, "heliocube")
    warning, clock = tmp_path / "warning", Clock()
    warning.write_text("hail\n")
    watch(clock).reasons(clock.now_s)
    warning.write_text("clear\n")
    again = watch(clock)
    (why,) = again.reasons(clock.now_s + 1.0)
    assert "says 'hail'" in why
    assert again.reasons(clock.now_s + CALM_S) == ()
