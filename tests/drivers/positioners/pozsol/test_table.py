import random

import pytest

from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.wire import Field, TokenStream, encode_command
from sim_drivers.pozsol.core import PositionerCore


def axis_a(angle_deg):
    return [b"%c%.1f" % (Field.A_ANGLE, angle_deg), b"%c1.0" % Field.A_POSITION, b"%c1.0" % Field.A_DESTINATION]


def take_together(table, *blocks):
    for at, angles in enumerate(blocks):
        assert table.jumped_s is None
        table.take([token for angle_deg in angles for token in axis_a(angle_deg)], 0.27 * at, waited_s=0.25)


@pytest.mark.parametrize("last", [(10.0, 14.0, 14.0), (16.0, 16.0)])
def test_a_jump_of_the_angle_is_detected_in_screens_that_were_gathered(last):
    table = FieldTable()
    take_together(table, (10.0, 10.0), (10.0, 10.0), (10.0, 10.0), last)
    assert (table.get(Field.A_ANGLE).number, table.jumped_s) == (last[-1], 0.27 * 3)


@pytest.mark.parametrize("last", [(13.0, 13.0), (10.0, 90.0)])
def test_a_possible_turn_and_a_single_outlier_in_gathered_screens_are_not_a_jump(last):
    table = FieldTable()
    take_together(table, (10.0, 10.0), (10.0, 10.0), last, (last[0], last[0]))
    assert (table.get(Field.A_ANGLE).number, table.jumped_s) == (last[0], None)


@pytest.mark.parametrize("following", [b"%c0" % Field.STATUS, b"%c10.2" % Field.A_ANGLE, b"%c20.0" % Field.B_ANGLE])
def test_a_screen_that_has_lost_its_end_is_ended_by_any_following_field(following):
    table = FieldTable()
    table.take(axis_a(10.0), 0.0)
    table.take([*axis_a(10.1)[:2], following], 0.27)
    assert table.get(Field.A_ANGLE).number == 10.1


@pytest.mark.parametrize(("pause_s", "jumped_s", "unseen_s"), [(0.1, 0.3, None), (1.1, None, 1.2)])
def test_a_large_change_after_an_unplanned_pause_counts_as_unseen_motion_and_not_as_a_jump(pause_s, jumped_s, unseen_s):
    table = FieldTable()
    for now_s, angle_deg in ((0.0, 10.0), (pause_s, 10.0), (pause_s + 0.1, 20.0), (pause_s + 0.2, 20.0)):
        table.take(axis_a(angle_deg), now_s)
    assert table.get(Field.A_ANGLE).number == 20.0
    assert table.jumped_s == pytest.approx(jumped_s)
    assert table.moved_unseen_s == pytest.approx(unseen_s), "it may have gone there"


def garbled(screen, dice):
    """Return a screen; now and then a byte of it is lost or changed."""
    if dice.random() < 0.9:
        return screen
    place = dice.randrange(len(screen))
    return screen[:place] + dice.choice((b"", b"9", b"-", b"$")) + screen[place + 1 :]


@pytest.mark.parametrize("seed", range(16))
def test_taking_a_block_of_screens_gives_the_same_table_as_taking_its_fields_one_by_one(seed):
    dice = random.Random(seed)
    core, stream, at_once, singly = PositionerCore(), TokenStream(), FieldTable(), FieldTable()
    now_s = 0.0
    for block in range(60):
        if block % 20 == 10:
            core.feed(encode_command(Field.A_ANGLE, dice.uniform(-40.0, 40.0)), now_s)
        data = b""
        for _ in range(dice.choice((1, 6, 12))):
            now_s += 0.02
            data += garbled(core.next_screen(now_s), dice)
        tokens = stream.feed_tokens(data)
        at_once.take(tokens, now_s)
        for token in tokens:
            singly.take([token], now_s)
        # Compared as text, because NaN does not equal itself.
        assert repr(at_once.snapshot()) == repr(singly.snapshot())
        assert at_once.jumped_s == singly.jumped_s
