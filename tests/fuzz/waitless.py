"""Runs coroutines that never wait."""

from collections.abc import Coroutine


def drive(work: Coroutine[object, object, object]) -> object:
    """Run a coroutine to its end without an event loop; one that waits fails."""
    try:
        work.send(None)
    except StopIteration as end:
        return end.value
    raise AssertionError("it waits for something")
