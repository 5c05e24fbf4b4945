"""How often the positioner is looked at."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Polling:
    """How often the positioner is looked at, at rest and on its way."""

    idle_s: float = 0.5
    moving_s: float = 0.5


OFTEN = Polling()
SIMULATED = Polling(idle_s=5.0)
"""For simulated days, where nothing moves by itself."""
