"""How long to wait before the next try to reach a device."""

from random import Random


class Backoff:
    """Growing delays with jitter and a cap, the same for every device.

    Parameters
    ----------
    random
        Source of the jitter: each delay is shortened by up to a fifth, so that devices lost together do not all come
        back in the same instant.
    first_s, factor, cap_s
        The first delay, what each following one is multiplied by, and the longest.
    """

    def __init__(self, random: Random, first_s: float = 0.5, factor: float = 1.8, cap_s: float = 8.0) -> None:
        self._random = random
        self._first_s = first_s
        self._factor = factor
        self._cap_s = cap_s
        self._delay_s = first_s

    def next_s(self) -> float:
        """Return the delay before the next try and lengthen the one after."""
        delay_s = self._delay_s * (1.0 - 0.2 * self._random.random())
        self._delay_s = min(self._delay_s * self._factor, self._cap_s)
        return delay_s

    def reset(self) -> None:
        """Start again from the first delay; to be called once the device has proven itself."""
        self._delay_s = self._first_s
