"""The wishes that are read back from their file."""

import json

import pytest

from daemon.base.state import StateFolder
from daemon.tracker.wishes import Wish, Wishes, WishFile


def loaded(tmp_path, text):
    (tmp_path / "operator.json").write_text(text)
    return WishFile(StateFolder(tmp_path)).load()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"stop": 1}',
        '{"stop": {"why": 3}}',
        '{"stop": {"by": "ana"}}',
        '{"halt": "x"}',
        '{"hold": {"why": "x", "since_utc_s": 1e300}}',
        '{"hold": {"why": "x", "since_utc_s": NaN}}',
        # No calendar goes so far: such a wish could be kept and never be shown.
        '{"hold": {"why": "x", "since_utc_s": -6.3e10}}',
        '{"hold": {"why": "x", "since_utc_s": 2.6e11}}',
        '{"hold": {"why": "x", "goto_deg": [10, NaN]}}',
        '{"hold": {"why": "x", "colour": "red"}}',
    ],
)
def test_an_operator_file_that_cannot_be_read_counts_as_a_stop(tmp_path, text):
    found = loaded(tmp_path, text)
    assert "operator.json cannot be read" in found.stop.why
    assert found.standstill_reason.startswith("stopped: ")


def test_an_operator_file_in_the_form_of_earlier_versions_is_read(tmp_path):
    found = loaded(tmp_path, '{"stop": null, "stow": "storm", "hold": null}')
    assert found == Wishes(stow=Wish(why="storm"))
    assert found.describe("stow") == "stowed: storm"


def test_wishes_that_were_saved_are_read_back_unchanged(tmp_path):
    wishes = Wishes(maintenance=Wish(why="greasing", by="ana@lab", since_utc_s=1665568803.25))
    WishFile(StateFolder(tmp_path)).save(wishes)
    assert WishFile(StateFolder(tmp_path)).load() == wishes
    assert wishes.standstill_reason == "in maintenance by ana@lab since 2022-10-12 10:00:03 UTC: greasing"


def test_of_many_requests_to_stop_the_first_eight_and_the_newest_are_kept(tmp_path):
    stop = Wish(why="repair", by="ana", since_utc_s=100.0)
    for number in range(20):
        stop = stop.joined_by(Wish(why=f"noise {number}", by="bob", since_utc_s=101.0 + number))
    told = [each.why for each in stop.all_requests]
    assert told == ["repair", *(f"noise {number}" for number in range(7)), "noise 19"]
    assert (stop.since_utc_s, stop.latest_utc_s) == (100.0, 120.0)
    again = stop.joined_by(Wish(why="repair", by="ana", since_utc_s=130.0))
    assert (again.also, again.since_utc_s, again.latest_utc_s) == (stop.also, 100.0, 130.0)
    WishFile(StateFolder(tmp_path)).save(Wishes(stop=again))
    assert WishFile(StateFolder(tmp_path)).load() == Wishes(stop=again)


def test_a_single_stop_is_saved_in_the_form_that_an_earlier_version_reads(tmp_path):
    WishFile(StateFolder(tmp_path)).save(Wishes(stop=Wish(why="repair", by="ana", since_utc_s=100.0)))
    kept = json.loads((tmp_path / "operator.json").read_text())
    assert kept == {"stop": {"why": "repair", "by": "ana", "since_utc_s": 100.0}}


def test_both_stops_are_returned_as_unseen_to_a_person_who_was_shown_only_the_first():
    first = Wish(why="repair", by="ana", since_utc_s=100.0)
    wishes = Wishes(stop=first.joined_by(Wish(why="a noise", by="bob", since_utc_s=200.0)))
    for unseen in (wishes.describe_unshown({"stop": first.since}), wishes.describe_newer_than(150.0)):
        assert unseen.endswith("UTC: repair; also by bob since 1970-01-01 00:03:20 UTC: a noise")
    assert wishes.describe_unshown({"stop": wishes.stop.latest}) is wishes.describe_newer_than(200.0) is None


def test_maintenance_is_named_before_a_stop_and_a_stop_before_the_buttons():
    wishes = Wishes(buttons=Wish(why="pressed"))
    assert wishes.standstill_reason == "held: pressed"
    wishes = wishes.model_copy(update={"stop": Wish(why="hand")})
    assert wishes.standstill_reason == "stopped: hand"
    wishes = wishes.model_copy(update={"maintenance": Wish(why="oil")})
    assert wishes.standstill_reason == "in maintenance: oil"
    assert list(wishes.describe_ended(Wishes())) == ["in maintenance: oil", "stopped: hand", "held: pressed"]
