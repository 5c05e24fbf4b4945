"""What has changed in the configuration from one start to the next."""

import json

import pytest

from daemon.base.clock import SystemClock
from daemon.store.settings_kept import FILE_NAME, publish_changes


@pytest.fixture
def started(tmp_path):
    """Start with some settings; returns the events."""

    def start(settings):
        told = []
        publish_changes(settings, tmp_path, SystemClock(), told.append)
        assert all(event.subject == "configuration" for event in told)
        return [event.text for event in told]

    return start


def test_a_first_start_and_one_with_unchanged_settings_report_nothing(started):
    assert started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}}) == []
    assert started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}}) == []


def test_each_setting_that_was_changed_added_or_removed_is_reported_once(started):
    started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}, "old": 1})
    after = {"safety": {"wind": 12.0}, "law": {"driver": "optimal"}, "new": [1, 2]}
    assert started(after) == [
        "safety.wind was 15.0 and is 12.0",
        "old was 1 and is not there",
        "new was not there and is [1, 2]",
    ]
    assert started(after) == []


def test_more_than_40_changed_settings_are_reported_by_their_number_and_long_values_are_cut(started):
    started({})
    told = started({f"key{number}": "x" * 500 for number in range(100)})
    assert len(told) == 41
    assert told[-1] == "60 more keys have changed"
    assert max(map(len, told)) < 200


@pytest.mark.parametrize("content", ["", "{", "[]", json.dumps({"values": {"a": 1}})])
def test_an_unusable_file_of_earlier_settings_reports_no_change_and_is_written_anew(started, tmp_path, content):
    (tmp_path / FILE_NAME).write_text(content)
    assert started({"a": 1}) == []
    assert started({"a": 2}) == ["a was 1 and is 2"]


def test_a_file_of_settings_that_cannot_be_written_does_not_prevent_a_start(started, tmp_path):
    (tmp_path / FILE_NAME).mkdir()
    assert started({"a": 1}) == []
