"""Which of the tests that wait runs where: the longest first, and costly ones not everywhere."""

import functools
import re

LONG_S, COSTLY_S, SHORT_S = 40, 12, 2
"""How long a test is taken to last: marked `long`; with processes or firmware of its own; on a port or a broker."""

_DEAR = {"system", "campaign", "firmware"}
# Fixtures that take seconds of a processor, once for all tests of a worker.
_SHARED = ("postgres", "browser", "copied_on_windows")


def expected_duration_s(item):
    """Return how long a test is taken to last [s]."""
    marks = {mark.name for mark in item.iter_markers()}
    return LONG_S if "long" in marks else COSTLY_S if marks & _DEAR else SHORT_S


def long_first(items):
    """Return the items with those marked `long` first: if one began last, all workers would wait for it."""
    return sorted(items, key=lambda item: item.get_closest_marker("long") is None)


def worker_group(item):
    """Return the costly fixture that a test shares with others, for one worker to make for all, or its own name."""
    return next((name for name in _SHARED if name in item.fixturenames), item.nodeid)


def distribute_tests(items, workers, length_s=expected_duration_s, group=worker_group):
    """Return the items in an order that suits `--dist worksteal`, which gives each worker one piece of equal size.

    Each piece begins with its longest, so that what others steal from its end is short. A group stays together, as one
    test that lasts as long as all of them. One worker in three gets costly tests only when nothing else is left.
    """
    room = [len(items) // workers + (worker >= workers - len(items) % workers) for worker in range(workers)]
    pieces = [[] for _ in range(workers)]
    spent_s = [0.0] * workers
    for length, members in _groups(items, length_s, group):
        free = [worker for worker in range(workers) if len(pieces[worker]) + len(members) <= room[worker]]
        if length >= COSTLY_S:
            free = [worker for worker in free if worker % 3 != 2] or free
        # A group that fits into no piece as a whole goes on in the next.
        order = sorted(free or range(workers), key=spent_s.__getitem__)
        for member in members:
            worker = next(one for one in order if len(pieces[one]) < room[one])
            pieces[worker].append(member)
            spent_s[worker] += length_s(member)
    return [item for piece in pieces for item in piece]


def _groups(items, length_s, group):
    """Return the length and the members of each group, the longest first."""
    members = {}
    for item in items:
        members.setdefault(group(item), []).append(item)
    lengths = [(sum(map(length_s, each)), sorted(each, key=length_s, reverse=True)) for each in members.values()]
    return sorted(lengths, key=lambda found: found[0], reverse=True)


@functools.cache
def _whole_words(words):
    return re.compile(rf"\b(?:{'|'.join(map(re.escape, words))})\b")


def contains_any_word(file, words):
    """Return whether a file contains one of the words, as a whole word."""
    return _whole_words(tuple(words)).search(file.read_text(encoding="utf-8")) is not None
