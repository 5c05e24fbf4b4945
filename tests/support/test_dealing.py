import pytest

from tests.support.dealing import COSTLY_S, LONG_S, SHORT_S, contains_any_word, distribute_tests, long_first


def pieces_of(order, workers):
    # As pytest-xdist's worksteal divides them.
    left = list(order)
    for worker in range(workers):
        size = len(left) // (workers - worker)
        yield left[:size]
        del left[:size]


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_each_worker_begins_with_its_longest_tests_and_the_long_ones_are_spread_over_the_workers(workers):
    lengths = [SHORT_S] * 31 + [LONG_S] * 7 + [COSTLY_S] * 17
    order = distribute_tests(range(len(lengths)), workers, lengths.__getitem__, int)
    assert sorted(order) == list(range(len(lengths)))
    pieces = [[lengths[number] for number in piece] for piece in pieces_of(order, workers)]
    assert all(piece == sorted(piece, reverse=True) for piece in pieces)
    assert max(piece.count(LONG_S) for piece in pieces) <= 7 // max(1, workers - workers // 3) + 1


def test_one_worker_of_three_gets_only_short_tests_while_there_are_enough():
    lengths = [SHORT_S] * 20 + [COSTLY_S] * 10
    order = distribute_tests(range(30), 3, lengths.__getitem__, int)
    assert {lengths[number] for number in order[20:]} == {SHORT_S}


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_the_tests_of_a_group_stay_together_at_the_beginning_of_one_workers_share(workers):
    group = range(0, 12, 2)
    order = distribute_tests(
        range(40), workers, lambda _: COSTLY_S, lambda number: "group" if number in group else number
    )
    assert sorted(order) == list(range(40))
    assert list(group) in [piece[:6] for piece in pieces_of(order, workers)]


def test_a_group_of_tests_that_is_larger_than_a_workers_share_loses_none():
    assert sorted(distribute_tests(range(10), 5, lambda _: SHORT_S, lambda _: "all")) == list(range(10))


def test_tests_marked_long_come_first_and_the_others_keep_their_order():
    class Item:
        def __init__(self, name, *marks):
            self.name, self.marks = name, marks

        def get_closest_marker(self, name):
            return name if name in self.marks else None

    items = [Item("a"), Item("b", "long"), Item("c", "slow"), Item("d", "long")]
    assert "".join(item.name for item in long_first(items)) == "bdac"


def test_a_name_is_found_in_a_file_only_as_a_whole_word(tmp_path):
    file = tmp_path / "test_it.py"
    file.write_text("def test_it(scaled_figure, unit):\n    pass\n")
    assert contains_any_word(file, ["unit", "scaled"])
    assert not contains_any_word(file, ["scaled", "figure"])
