"""The Agilent (HP) 6063B electronic load, on GPIB.

From the manual of the same family (6050 series, where this model's own was not found): the commands, several questions
in one line, 9.9E+37 for a reading beyond the range, the channel status bits, that a change of mode switches the input
off for a moment, and that over-current, over-power and over-temperature shut the input down until the protection is
cleared. Seen in a public driver: ``VOLT?`` returns what was set and not what is there, replies end with CR LF.
Not confirmed by a document: ``MODE?`` answers VOLT; 250 W, 10 A, 3 to 240 V, of which a module of 305 Wp can exceed the
first two. Not used: the flag "unregulated", which the family's manual says does not come in this mode.
"""

from drivers.load.connection import VisaLoadSettings, load_line, sweep_settings
from drivers.load.session import Dialect
from drivers.load.sweep import ScpiLoad, SweepSettings
from drivers.scpi import ScpiLine
from drivers.transcript import Tap, no_tap

PROTECTIONS = {
    1: "voltage fault",
    2: "over-current",
    8: "over-power",
    16: "over-temperature",
    2048: "reverse voltage",
    4096: "over-voltage",
    8192: "protection shutdown",
}

DIALECT = Dialect(
    maker="",
    models=("6063B", "HP6063B"),
    select="",
    select_proof=None,
    identify_channel="",
    on="INP ON",
    off="INP OFF",
    on_query="INP?",
    mode="MODE:VOLT",
    mode_proof=("MODE?", "VOLT"),
    settings=("TRAN OFF", "CURR:RANG MAX"),
    level="VOLT {:.3f}",
    measure="MEAS:VOLT?;CURR?;:STAT:CHAN:COND?",
    measure_one_by_one=("MEAS:VOLT?", "MEAS:CURR?", "STAT:CHAN:COND?"),
    protection="STAT:CHAN:COND?",
    clear_protection="INP:PROT:CLE",
    protections=PROTECTIONS,
)


class AgilentSettings(VisaLoadSettings):
    """agilent6063b: an Agilent or HP 6063B."""


class Agilent6063B(ScpiLoad):
    """The load; parameters as those of `drivers.load.sweep.ScpiLoad`."""

    def __init__(self, line: ScpiLine, settings: SweepSettings) -> None:
        super().__init__(line, DIALECT, settings)


SETTINGS = AgilentSettings


def build(settings: AgilentSettings, tap: Tap = no_tap) -> Agilent6063B:
    """Return the load, not yet connected; `SettingsError` if the settings do not say where it is."""
    return Agilent6063B(load_line(settings, tap), sweep_settings(settings))
