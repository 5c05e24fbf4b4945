"""Numbers that somebody else has written as text."""

import re

_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?\s*", re.ASCII | re.IGNORECASE)


def read_number(text: str) -> float:
    """Return the number that a text gives in the digits 0 to 9; infinite if it is too large.

    `float` alone accepts more, which no sender means: ``1_5`` for 15, digits of other scripts, ``nan``.

    Raises
    ------
    ValueError
        The text is no number.
    """
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{text!r} is not a number")
    return float(text)
