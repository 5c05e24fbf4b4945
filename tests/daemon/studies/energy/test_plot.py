"""What the benchmark's picture shows of each law, and that its texts can be read."""

from itertools import combinations

import numpy as np
import pytest

from daemon.studies.energy.benchmark import EnergyRow
from daemon.studies.energy.plot import picture


def row(law, gain_pct, share_pct, travel_deg_per_day=np.nan, sky="perez1990"):
    return EnergyRow(
        sky, law, 5.0, gain_pct, (gain_pct, np.nan, np.nan, np.nan), share_pct, gain_pct, travel_deg_per_day, 0.0, 1.0
    )


BOUND = row("bound", 33.15, 100.0)
OVERCAST = (
    row("fixed:35", 21.0, 63.3, 35.0),
    row("chronometric", 0.0, 0.0, 261.0),
    row("flat", 33.14, 99.9, 0.0),
    row("mu-prime", 33.05, 99.7, 53.0),
    row("optimal", 33.01, 99.6, 4.0),
    row("sun-vector", 30.58, 92.2, 303.0),
    BOUND,
)
CLEAR = (
    row("fixed:35", -26.0, -61000.0, 35.0),
    row("chronometric", 0.0, -2.0, 262.0),
    row("flat", -56.0, -130000.0, 0.0),
    row("optimal", 0.03, 73.4, 233.0),
    row("sun-vector", -0.01, -14.9, 279.0),
    row("bound", 0.04, 100.0),
)
STILL = (row("flat", 33.14, 99.9, 0.0), row("optimal", 33.01, 99.6, 0.05))


NO_ROOM = (row("flat", -76.0, np.nan, 0.0), row("optimal", -0.02, np.nan, 196.0), row("bound", 0.0, np.nan))

DAYS = {"overcast": OVERCAST, "clear": CLEAR, "still": STILL}


@pytest.fixture(scope="module")
def pictures():
    """The picture of each day, drawn once."""
    return {name: picture(rows) for name, rows in DAYS.items()}


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()] if figure.legends else []


def colours(axes):
    return {bar.get_facecolor() for bar in axes.patches}


def test_a_law_that_loses_too_much_for_a_bar_is_named_with_its_loss(pictures):
    assert pictures["clear"].axes[0].get_xlabel() == "without a bar, on all days: fixed:35 -26.0 %, flat -56.0 %"
    assert pictures["overcast"].axes[0].get_xlabel() == ""


def test_a_law_tried_only_with_parameters_has_no_bar_and_is_named_with_its_gains():
    tried = (row("optimal:0.5", 33.0, 99.5, 9.0), row("optimal:16", 2.0, 70.0, 3.0))
    alone, beside = picture((BOUND, *tried)), picture((*OVERCAST, *tried))
    assert alone.axes[0].get_xlabel() == "without a bar, on all days: optimal:0.5 +33.0 %, optimal:16 +2.0 %"
    assert beside.axes[0].get_xlabel() == ""


def test_each_name_of_the_legend_has_a_bar_of_its_colour(pictures):
    figure = pictures["overcast"]
    names = [row.law for row in OVERCAST]
    assert legend(figure) == names
    assert {patch.get_facecolor() for patch in figure.legends[0].get_patches()} == colours(figure.axes[0])
    assert len(colours(figure.axes[0])) == len(names)


def test_the_legend_has_nothing_that_is_not_drawn(pictures):
    assert legend(pictures["clear"]) == ["chronometric", "optimal", "sun-vector", "bound"]
    assert legend(pictures["still"]) == ["flat", "optimal"], "the bound was not asked for"
    assert legend(picture(CLEAR[:1])) == []


def test_a_law_without_a_mark_in_the_panel_of_wear_is_named_below_it_with_the_reason(pictures):
    assert pictures["clear"].axes[1].get_xlabel().endswith("\nbelow -60 %: fixed:35, flat")
    assert pictures["overcast"].axes[1].get_xlabel().endswith("\nnever moves: fixed:35")
    both = picture((*OVERCAST, row("optimal:16", -2.0, -70.0, 100.0)))
    assert both.axes[1].get_xlabel().endswith("\nbelow -60 %: optimal:16; never moves: fixed:35")
    label = picture(NO_ROOM).axes[1].get_xlabel()
    assert label.endswith("\nwithout a share, as the bound gains next to nothing: flat, optimal")


@pytest.mark.parametrize("day", DAYS)
def test_names_of_laws_lie_inside_the_panel_of_wear_and_do_not_overlap(pictures, day):
    axes = pictures[day].axes[1]
    frame, words = axes.get_window_extent(), [text.get_window_extent() for text in axes.texts]
    assert len(words) > 2
    assert all(frame.x0 <= word.x0 and word.x1 <= frame.x1 for word in words)
    assert all(frame.y0 <= word.y0 and word.y1 <= frame.y1 for word in words)
    assert not any(one.overlaps(other) for one, other in combinations(words, 2))


def words_on(axes):
    """Return the texts in a panel, and whether each lies on one of its horizontal lines."""
    levels = axes.transData.transform([(0.0, 0.0), (0.0, 100.0)])[:, 1]
    boxes = {text.get_text(): text.get_window_extent() for text in axes.texts}
    return {word: any(box.y0 <= level <= box.y1 for level in levels) for word, box in boxes.items()}


def test_no_name_lies_on_a_line_of_the_panel_of_wear():
    below_the_bound = row("flat", 20.0, 93.5, 20.0)
    above_zero = (row("mu-prime", 0.0, -4.5, 400.0), row("sun-vector", 0.0, -4.5, 900.0))
    words = words_on(picture((below_the_bound, *above_zero, BOUND)).axes[1])
    assert words == dict.fromkeys(("the bound", "flat", "mu-prime", "sun-vector"), False)


def test_marks_of_a_law_tried_with_parameters_show_their_values_and_the_name_of_the_parameter(pictures):
    tried = [row(f"optimal{value}", 1.0, share, 300.0 + share) for value, share in ((":4", 70), ("", 80), (":0.5", 81))]
    other_sky = [row(each.law, 1.0, each.share_pct - 3.0, each.travel_deg_per_day, "cie") for each in tried]
    axes = picture((*tried, *other_sky, BOUND)).axes[1]
    assert sorted(words_on(axes)) == ["0.5", "1", "4", "optimal, by thrift", "the bound"]
    number = next(text for text in axes.texts if text.get_text() == "4").get_window_extent()
    mark = axes.transData.transform((370.0, 70.0))
    assert np.hypot(*(number.corners().mean(axis=0) - mark)) < 30.0
    assert "optimal" in {text.get_text() for text in pictures["clear"].axes[1].texts}, "one setting needs no number"


@pytest.mark.parametrize("day", DAYS)
def test_the_panel_of_wear_has_room_left_of_zero_and_reaches_at_least_50_deg(pictures, day):
    left, right = pictures[day].axes[1].get_xlim()
    assert left < -1.0
    assert right >= 50.0
