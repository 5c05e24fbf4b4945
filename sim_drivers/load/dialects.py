"""What sets one make of electronic load apart from another: its words, its channels, its status bits, its rating."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

DialectName = Literal["chroma63600", "agilent6063b"]


@dataclass(frozen=True, slots=True)
class DialectFacts:
    """What one make does in its own way.

    Attributes
    ----------
    identity
        Its answer to ``*IDN?``.
    mode, constant_voltage
        The mode after ``*RST``, and the one for sweeps.
    channels
        Those that there are: modules with one input take every other number.
    bits
        Its status bits by protection.
    shutdown_bit, unregulated_bit
        Set with some protections, and while the set voltage is not met; 0 where there is none. The manual of the
        6063B's family says that the latter does not come in constant voltage; it does here, so that nothing is built
        on its absence.
    end
        What ends a reply.
    """

    identity: str
    mode: str
    constant_voltage: str
    channels: tuple[int, ...]
    bits: Mapping[str, int]
    shutdown_bit: int
    unregulated_bit: int
    end: bytes


DIALECTS: dict[DialectName, DialectFacts] = {
    "chroma63600": DialectFacts(
        identity="CHROMA,63600-5,636000001234,1.20",
        mode="CCH",
        constant_voltage="CVH",
        channels=(1, 3, 5, 7, 9),
        bits={"over-temperature": 1, "over-voltage": 2, "over-current": 4, "over-power": 8, "reverse-voltage": 16},
        shutdown_bit=0,
        unregulated_bit=0,
        end=b"\n",
    ),
    "agilent6063b": DialectFacts(
        identity="HEWLETT-PACKARD,6063B,0,A.02.01",
        mode="CURR",
        constant_voltage="VOLT",
        channels=(1,),
        bits={
            "over-temperature": 16,
            "over-voltage": 4096 | 1,
            "over-current": 2,
            "over-power": 8,
            "reverse-voltage": 2048 | 1,
        },
        shutdown_bit=8192,
        unregulated_bit=1024,
        end=b"\r\n",
    ),
}


@dataclass(frozen=True, slots=True)
class Rating:
    """What a load can do.

    Attributes
    ----------
    least_v
        Its transistors cannot pull the source below this.
    most_v, most_a
        Beyond the first it protects itself; at the second it holds the current.
    trips_w
        Power at which it shuts down.
    noise_v, noise_a
        Standard deviations of one reading.
    """

    least_v: float
    most_v: float
    most_a: float
    trips_w: float
    noise_v: float
    noise_a: float


# The voltages, currents and powers are those of the makers' model names; noise and margins are assumed.
RATINGS: dict[DialectName, Rating] = {
    "chroma63600": Rating(least_v=0.5, most_v=80.0, most_a=80.0, trips_w=420.0, noise_v=0.004, noise_a=0.004),
    "agilent6063b": Rating(least_v=3.0, most_v=240.0, most_a=10.2, trips_w=300.0, noise_v=0.010, noise_a=0.005),
}
