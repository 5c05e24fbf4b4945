"""What has changed in the configuration from one start to the next."""

import json

import pytest

from daemon.base.clock import SystemClock
from daemon.store.settings_kept import FILE_NAME, tell_changes


@pytest.fixture
def started(tmp_path):
    """Start with some settings; returns the events."""

    def start(settings):
        told = []
        tell_changes(settings, tmp_path, SystemClock(), told.append)
        assert all(event.subject == "configuration" for event in told)
        return [event.text for event in told]

    return start


def test_the_first_start_and_one_with_the_same_tell_nothing(started):
    assert started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}}) == []
    assert started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}}) == []


def test_each_key_that_changed_came_or_went_is_told_once(started):
    started({"safety": {"wind": 15.0}, "law": {"driver": "optimal"}, "old": 1})
    after = {"safety": {"wind": 12.0}, "law": {"driver": "optimal"}, "new": [1, 2]}
    assert started(after) == [
        "safety.wind was 15.0 and is 12.0",
        "old was 1 and is not there",
        "new was not there and is [1, 2]",
    ]
    assert started(after) == []


def test_a_flood_of_changes_is_counted_and_a_long_value_cut(started):
    started({})
    told = started({f"key{number}": "x" * 500 for number in range(100)})
    assert len(told) == 41
    assert told[-1] == "60 more keys have changed"
    assert max(map(len, told)) < 200


@pytest.mark.parametrize("content", ["", "{", "[]", json.dumps({"values": {"a": 1}})])
def test_a_file_that_says_nothing_tells_nothing_and_is_made_anew(started, tmp_path, content):
    (tmp_path / FILE_NAME).write_text(content)
    assert started({"a": 1}) == []
    assert started({"a": 2}) == ["a was 1 and is 2"]


def test_a_folder_that_cannot_be_written_keeps_nobody_from_starting(started, tmp_path):
    (tmp_path / FILE_NAME).mkdir()
    assert started({"a": 1}) == []
