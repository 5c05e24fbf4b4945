"""Where an axis stands after its count was lost, in units counted by hand, and which doubts a reference run settles."""

import pytest

from drivers.positioners.pozsol.reference import LastKnownPositions, Reference


def known(position=500.0, destination=500.0):
    last = LastKnownPositions()
    last.note("a", position, destination, trusted=True, set_anew=False)
    return last


def test_the_position_of_an_axis_is_known_from_its_first_trusted_count_on():
    last = LastKnownPositions()
    assert (last.of("a", 500.0), last.worst_case_position("a")) == (None, None)
    last.note("a", 500.0, 500.0, trusted=False, set_anew=False)
    assert (last.of("a", 500.0), last.worst_case_position("a")) == (None, None), (
        "nobody knows what a doubtful count is worth"
    )
    last.note("a", 510.0, 510.0, trusted=True, set_anew=False)
    assert (last.of("a", 520.0), last.worst_case_position("a"), last.of("b", 0.0)) == (520.0, 510.0, None)


def test_the_last_known_position_adds_up_what_each_reset_of_the_count_has_lost():
    last = known()
    last.note("a", 0.0, 0.0, trusted=False, set_anew=True)
    assert (last.of("a", 20.0), last.worst_case_position("a")) == (520.0, 500.0)
    last.note("a", 30.0, 30.0, trusted=False, set_anew=False)
    assert last.worst_case_position("a") == 530.0, "it has moved on by its count"
    last.note("a", -5.0, -5.0, trusted=False, set_anew=True)
    assert (last.of("a", -5.0), last.worst_case_position("a")) == (530.0, 530.0)
    last.note("a", 7.0, 7.0, trusted=True, set_anew=True)
    assert last.of("a", 7.0) == 7.0, "what is trusted is short of nothing"


def test_after_a_reference_run_without_motion_the_position_is_counted_from_where_the_axis_stood():
    last = known()
    last.note_stuck_switch("a", 500.0, 0.0)
    last.note("a", 0.0, 0.0, trusted=False, set_anew=False)
    assert (last.of("a", 0.0), last.of("a", 40.0), last.worst_case_position("a")) == (500.0, 540.0, 500.0)
    last.note_referenced("a")
    assert last.of("a", 40.0) == 40.0


def test_a_run_that_its_switch_may_have_cut_short_leaves_two_possible_positions_until_a_good_run():
    last = known()
    last.note_referenced("a")
    last.note_contradiction("a", 200.0, 3.0)
    last.note("a", 3.0, 3.0, trusted=False, set_anew=False)
    assert (last.of("a", 3.0), last.worst_case_position("a")) == (3.0, 200.0)
    last.note("a", -7.0, -7.0, trusted=False, set_anew=True)
    assert (last.of("a", -7.0), last.worst_case_position("a")) == (3.0, 200.0), (
        "both places outlive a count that is lost"
    )
    last.note_referenced("a")
    assert (last.of("a", 3.0), last.worst_case_position("a")) == (3.0, -7.0)


def test_a_recalled_position_is_taken_as_last_position_and_last_destination_of_the_axis():
    last = LastKnownPositions()
    last.recall("a", 300.0)
    assert (last.of("a", 310.0), last.worst_case_position("a")) == (310.0, 300.0)
    assert last.stray_text("a", 305.0, 5.0) == ""
    assert last.stray_text("a", 305.1, 5.0) == (
        "axis A has the count 305, and had 300 when it was seen last: it was moved by hand, or its count is lost"
    )


@pytest.mark.parametrize(
    ("shown", "told", "position", "strays"),
    [
        (500.0, None, 495.0, False),
        (500.0, None, 494.9, True),
        (500.0, None, 505.0, False),
        (500.0, None, 505.1, True),
        (800.0, None, 650.0, False),
        (800.0, None, 805.1, True),
        (100.0, None, 300.0, False),
        (100.0, None, 94.9, True),
        # A target that was sent and is not shown yet counts beside the one that is shown.
        (500.0, 900.0, 905.0, False),
        (500.0, 900.0, 905.1, True),
        (500.0, 900.0, 494.9, True),
    ],
)
def test_an_axis_has_strayed_only_if_no_shown_or_sent_destination_explains_its_position(shown, told, position, strays):
    last = LastKnownPositions()
    assert last.stray_text("a", position, 5.0) == "", "nobody has seen it"
    if told is not None:
        last.note_target("a", told)
    last.note("a", 500.0, shown, trusted=True, set_anew=False)
    assert bool(last.stray_text("a", position, 5.0)) is strays


@pytest.mark.parametrize(("shown", "waits"), [(899.4, True), (899.5, False), (900.5, False), (900.6, True)])
def test_a_sent_target_explains_a_position_until_it_has_been_shown_or_the_axes_stand(shown, waits):
    last = known()
    last.note_target("a", 900.0)
    last.note("a", 500.0, shown, trusted=True, set_anew=False)
    last.note("a", 500.0, 500.0, trusted=True, set_anew=False)
    assert (last.stray_text("a", 700.0, 5.0) == "") is waits
    last.forget_targets()
    assert last.stray_text("a", 700.0, 5.0)


def test_a_run_without_travel_settles_no_doubt_that_needs_travel_and_each_run_only_its_own_axis():
    reference = Reference()
    assert (reference.text, reference.kinds, reference.possible_position("a")) == ("", (), None)
    reference.note("reset", "has restarted")
    reference.note("a switch", "its switch lies", "a", needs_travel=True, stands=150.0)
    reference.note("a run", "its run ended early", "a", needs_travel=True, stands=400.0)
    assert reference.possible_position("a") == 400.0, "the farther one of two"
    assert reference.possible_position("b") is None
    reference.proven("a", travelled=False)
    assert reference.doubts("a")
    assert reference.kinds == ("reset", "a switch", "a run")
    reference.proven("b", travelled=False)
    assert not reference.doubts("b")
    assert reference.kinds == ("a switch", "a run")
    assert reference.text == "its switch lies; its run ended early"
    reference.forgive(("a switch", "unheard of"))
    assert reference.doubts("a")
    reference.proven("a", travelled=True)
    assert (reference.text, reference.doubts("a")) == ("", False)
