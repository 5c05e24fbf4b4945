"""Words that depend on a number, for sentences that people read."""


def pluralise(number: int, one: str, many: str = "") -> str:
    """Return how many there are: ``1 day``, ``2 days``; `many` is for plurals that an s at the end does not make."""
    return f"{number} {one if number == 1 else many or f'{one}s'}"
