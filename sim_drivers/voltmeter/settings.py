"""What the commands of the simulated Keithley 2000 set."""

from dataclasses import dataclass

RANGES_V = (0.1, 1.0, 10.0, 100.0, 1000.0)


@dataclass(frozen=True, slots=True)
class MeterSettings:
    """Everything that commands set. The defaults are those of ``*RST``.

    Attributes
    ----------
    filter_kind
        ``REP`` averages fresh conversions, ``MOV`` a window that moves over old ones.
    continuous
        Measures freely; ``:READ?`` and ``:INIT`` are then ignored.
    reference_v, reference_on
        What the REL key takes off every reading [V], and whether it does.
    math_factor, math_on
        What the MX+B key multiplies every reading by, and whether it does.
    panel
        ``LOC``, ``REM`` or, with the front panel locked out, ``RWL``.
    event_enable, request_enable
        Masks of the standard event register and of the status byte.
    """

    function: str = "VOLT:DC"
    range_v: float = 1000.0
    autorange: bool = True
    nplc: float = 1.0
    digits: int = 7
    filter_on: bool = False
    filter_kind: str = "MOV"
    filter_count: int = 10
    reference_v: float = 0.0
    reference_on: bool = False
    math_factor: float = 1.0
    math_on: bool = False
    autozero: bool = True
    continuous: bool = False
    trigger_source: str = "IMM"
    trigger_count: int = 1
    trigger_delay_s: float = 0.0
    sample_count: int = 1
    data_format: str = "ASC"
    elements: tuple[str, ...] = ("READ",)
    beeper: bool = True
    panel: str = "LOC"
    event_enable: int = 0
    request_enable: int = 0

    def formatted(self, reading: str, *, overflow: bool = False) -> str:
        """Return a reading with the elements that are asked for, always in the instrument's order."""
        if self.elements == ("READ",):
            return reading
        units = "UNIT" in self.elements
        parts = [reading + ("VDC" if units and not overflow else "")] if "READ" in self.elements else []
        if "CHAN" in self.elements:
            parts.append("0INTCHAN" if units else "0")
        return ",".join(parts)


RESET = MeterSettings()
PRESET = MeterSettings(filter_on=True, continuous=True, elements=("READ", "CHAN", "UNIT"))
"""The bench defaults, which also hold after power-up: free-running, with the moving filter on."""
