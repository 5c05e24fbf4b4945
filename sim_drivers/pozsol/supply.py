"""The motor supply of the simulated positioner: below one voltage it takes no target, below another it stops."""

import math

NOMINAL_V, LOW_V = 24.0, 15.0
MOVE_V, CUT_OFF_V = 20.0, 17.0
RECOVERY_S = 5.0
"""How long after an undervoltage targets are refused."""


class MotorSupply:
    """What the motors get, and what the unit refuses because of it.

    Attributes
    ----------
    volts
        The voltage that the unit shows.
    """

    def __init__(self) -> None:
        self.volts = NOMINAL_V
        self._refuses_until_s = -math.inf

    def set(self, volts: float, now: float) -> None:
        """Change the voltage."""
        if self.volts < MOVE_V <= volts:
            self._refuses_until_s = now + RECOVERY_S
        self.volts = volts

    @property
    def cuts_off(self) -> bool:
        """Whether a motor that runs is stopped."""
        return self.volts < CUT_OFF_V

    def refuses(self, now: float) -> bool:
        """Tell whether targets and reference runs are refused."""
        return now < self._refuses_until_s or self.volts < MOVE_V
