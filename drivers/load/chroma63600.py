"""The Chroma 63600 electronic load: one channel of its mainframe, in the high voltage range.

From the maker's manual: the commands, the answer to ``*IDN?`` (``CHROMA,63600-5,...``), the status bits, and that
channels of modules with one input are numbered 1, 3, 5 and so on. Seen in a public driver: ``CHAN n`` before channel
commands, ``CHAN:ID?``, replies to ``LOAD?`` as ON, OFF or a number. Inferred, not tried on an instrument: that several
questions in one line are answered in one line with semicolons (where they are not, they are asked one by one), that
``MODE?`` answers in the short form, and how long a new voltage takes. Errors are read from ``*ESR?``, which the manual
has; an error queue is not used.
"""

from pydantic import Field

from drivers.load.connection import VisaLoadSettings, load_line, sweep_settings
from drivers.load.session import Dialect
from drivers.load.sweep import ScpiLoad, SweepSettings
from drivers.scpi import ScpiLine
from drivers.transcript import Tap, no_tap

PROTECTIONS = {
    1: "over-temperature",
    2: "over-voltage",
    4: "over-current",
    8: "over-power",
    16: "reverse voltage",
    32: "synchronisation",
    64: "limit",
    128: "fan",
    256: "remote inhibit",
}


def dialect(channel: int) -> Dialect:
    """Return how one channel is spoken to."""
    return Dialect(
        maker="CHROMA",
        models=("63600", "636"),
        select=f"CHAN {channel}",
        select_proof=("CHAN?", str(channel)),
        identify_channel="CHAN:ID?",
        on="LOAD ON",
        off="LOAD OFF",
        on_query="LOAD?",
        mode="MODE CVH",
        mode_proof=("MODE?", "CVH"),
        settings=("CONF:VOLT:RANG HIGH", "VOLT:STAT:ILIM MAX"),
        level="VOLT:STAT:L1 {:.3f}",
        measure="MEAS:VOLT?;CURR?;:LOAD:PROT?",
        measure_one_by_one=("MEAS:VOLT?", "MEAS:CURR?", "LOAD:PROT?"),
        protection="LOAD:PROT?",
        clear_protection="LOAD:PROT:CLE",
        protections=PROTECTIONS,
    )


class ChromaSettings(VisaLoadSettings):
    """chroma63600: a channel of a Chroma 63600 mainframe."""

    channel: int = Field(
        1, ge=1, le=10, description="Channel of the mainframe; modules with one input are 1, 3, 5, 7, 9."
    )


class Chroma63600(ScpiLoad):
    """The load at one channel; parameters as those of `drivers.load.sweep.ScpiLoad`."""

    def __init__(self, line: ScpiLine, channel: int, settings: SweepSettings) -> None:
        super().__init__(line, dialect(channel), settings)


SETTINGS = ChromaSettings


def build(settings: ChromaSettings, tap: Tap = no_tap) -> Chroma63600:
    """Return the load, not yet connected; `SettingsError` if the settings do not say where it is."""
    return Chroma63600(load_line(settings, tap), settings.channel, sweep_settings(settings))
