"""What the service asks of an instrument, real or simulated.

Every method may raise a child of :class:`drivers.errors.DeviceError` and nothing else. ``open`` may be called again
after ``close``; it always identifies and configures the instrument anew. Times are on the service's monotonic clock.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

AxisName = Literal["a", "b"]


class Multiplexer(Protocol):
    """Routes one of several inputs to the voltmeter."""

    async def open(self) -> str:
        """Connect and return a sentence that identifies the instrument."""

    async def close(self) -> None:
        """Release the instrument. Never raises."""

    async def select(self, channel: int) -> None:
        """Route input `channel` to the output; returns once the address is on the lines, not yet settled."""


class Voltmeter(Protocol):
    """Measures DC voltage."""

    async def open(self) -> str:
        """Connect, identify and configure; return the instrument's identity."""

    async def close(self) -> None:
        """Release the instrument. Never raises."""

    async def read_voltage(self) -> float:
        """Return one conversion [V] that began after the call; `OverRangeError` where there is none."""


FaceFlaw = Literal["over-range", "late", "missing"]
"""Why a face was not read: it was beyond the range; no answer came in time; the answer was no reading."""


class FaceSample(NamedTuple):
    """What one face read.

    Attributes
    ----------
    value
        In the unit of the reading; NaN where the face was not read.
    time_utc_s, time_monotonic_s
        When the face was measured, or when that failed.
    flaw
        Why it was not read; None where it was.
    note
        What the sensor reports to be wrong with itself, or why it has long given nothing: a sentence for people that
        names the face; empty while all is well.
    """

    value: float
    time_utc_s: float
    time_monotonic_s: float
    flaw: FaceFlaw | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class CubeReading:
    """The four faces, read once.

    Attributes
    ----------
    east, south, west, zenith
        The faces, the zenith measured last or with the others.
    unit
        ``V`` for what bare sensors give, to which dark offsets and gains of the settings apply; ``W/m2`` for sensors
        that apply their own.
    proven
        False if a test of the signal path has failed; True if it has passed, or if there is no test.
    rounded
        The values come in steps, so that a steady light gives the same one again and again.
    """

    east: FaceSample
    south: FaceSample
    west: FaceSample
    zenith: FaceSample
    unit: Literal["V", "W/m2"]
    proven: bool = True
    rounded: bool = False

    @property
    def faces(self) -> tuple[FaceSample, FaceSample, FaceSample, FaceSample]:
        """East, south, west, zenith."""
        return self.east, self.south, self.west, self.zenith

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the faces that have one."""
        return tuple(face.note for face in self.faces if face.note)


class Cube(Protocol):
    """Reads four faces: volts through a multiplexer or a scanning meter, or pyranometers that tell irradiances."""

    async def open(self) -> str:
        """Connect, identify and configure; return a sentence that identifies the instruments."""

    async def close(self) -> None:
        """Release the instruments. Never raises."""

    async def read(self) -> CubeReading:
        """Return a reading of all faces that began after the call.

        A face that gives no value is flawed and costs the others nothing; a link that is gone raises `DeviceError`.
        """


@dataclass(frozen=True, slots=True)
class PositionerIdentity:
    """Who the positioner says it is.

    Attributes
    ----------
    board, firmware, serial
        As the positioner tells them; empty where it does not.
    simulated
        True for a simulated positioner that is known to be one.
    setup_conflicts
        Where the positioner's own geometry, offsets or ranges contradict the configuration, a sentence each; nothing
        may be moved before they agree.
    """

    board: str
    firmware: str
    serial: str
    simulated: bool = False
    setup_conflicts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One look at the positioner, in words that hold for any make.

    Attributes
    ----------
    time_monotonic_s
        When the oldest of angles, positions and destinations was received.
    a_deg, b_deg
        Measured angles: A -50 East .. +50 West, B 90 flat .. 15.
    position_a, position_b, destination_a, destination_b
        Where the axes stand and where the drive sends them, both in what the drive counts in: the `position_unit` of
        its settings. Standstill is judged by them, since they are finer than the angles.
    faults
        Latched faults in words, as people are shown them, such as ``a_overcurrent``; empty when there are none.
    was_reset
        The positioner reports that it restarted since its faults were last cleared: its reference is in doubt.
    button_pressed
        The positioner is operated by hand: somebody stands beside it.
    homing
        A reference run is on; the driver says so until it has judged how the run ended.
    aims_home
        An axis has a destination that only a reference run gives it; for makes that show this before `homing`.
    reference_doubt
        Why the driver does not trust the count, such as a restart, a jump of the count, or a reference run that did not
        end where it should. Stays until reference runs of both axes have succeeded, or until `clear_faults`.
    autonomous
        A mode of the positioner's own, such as sun tracking, may move the axes.
    own_moves
        Settings of the positioner that may move the axes at some time, in words; empty as long as none is known to be
        on.
    status_monotonic_s
        When faults, `was_reset`, `button_pressed`, `homing` and `autonomous` were received.
    supply_v
        Motor supply; NaN where the positioner does not tell.
    a_motor_current_a, b_motor_current_a
        Motor currents; NaN where the positioner does not tell.
    details
        What else the positioner tells, for people only: shown as it is, by name, and never used for a decision. A name
        is lower-case words joined by underscores, with the unit at its end.
    """

    time_monotonic_s: float
    a_deg: float
    b_deg: float
    position_a: float
    position_b: float
    destination_a: float
    destination_b: float
    faults: tuple[str, ...] = ()
    was_reset: bool = False
    button_pressed: bool = False
    homing: bool = False
    aims_home: bool = False
    autonomous: bool = False
    own_moves: tuple[str, ...] = ()
    reference_doubt: str = ""
    status_monotonic_s: float = 0.0
    supply_v: float = math.nan
    a_motor_current_a: float = math.nan
    b_motor_current_a: float = math.nan
    details: Mapping[str, str | float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Turn numpy's numbers into Python's: neither the store nor any message takes numpy's."""
        for name in self.__slots__:
            value = getattr(self, name)
            if hasattr(value, "item"):
                object.__setattr__(self, name, value.item())
        if any(hasattr(value, "item") for value in self.details.values()):
            object.__setattr__(self, "details", {name: _of_python(value) for name, value in self.details.items()})

    def with_time(self, time_s: float) -> "Telemetry":
        """Return the same look, made once more at this time [s]: its values need no second conversion."""
        later = object.__new__(Telemetry)
        for name in Telemetry.__slots__:
            object.__setattr__(later, name, getattr(self, name))
        for name in ("time_monotonic_s", "status_monotonic_s"):
            object.__setattr__(later, name, time_s)
        return later

    @property
    def needs_homing(self) -> str:
        """Why no move may rely on its angles, faults included, as words of a sentence; empty where one may."""
        restarted = "has restarted" if self.was_reset else ""
        return ", ".join(filter(None, (*self.faults, restarted, self.reference_doubt)))


def _of_python(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


class Positioner(Protocol):
    """Two motor axes with telemetry."""

    async def open(self) -> PositionerIdentity:
        """Connect and identify; sends nothing that could move an axis."""

    async def close(self) -> None:
        """Release the instrument. Never raises, and does not stop a move."""

    async def read_telemetry(self) -> Telemetry:
        """Return the present state; `LinkLostError` when the positioner has gone silent."""

    async def disable_autonomy(self) -> None:
        """Switch off what may move the axes without a command; `RefusedError` if it stays on."""

    async def move_to(self, a_deg: float, b_deg: float, *, first: AxisName = "a") -> None:
        """Start a move, axis `first` before the other, and return once the positioner has taken the target.

        Raises `ValueError` for a target outside the driver's own limits (NaN included) and `RefusedError` if it
        is not taken; one of the axes may be on its way then, so `halt` has to follow.
        """

    async def stop(self) -> None:
        """Send stop once and at once, before anything that waits. A single stop may be lost: only `halt` makes sure."""

    async def halt(self) -> None:
        """Send stop again and again until telemetry shows both axes standing; `StillMovingError` if they do not."""

    async def home(self, axis: AxisName) -> None:
        """Halt both axes, start a reference run of one, and return once it has begun."""

    async def clear_faults(self, *, forgive: bool = True) -> Telemetry:
        """Clear latched faults and `was_reset`; return the last look before that, its status no older than the call.

        That look shows what was cleared; a fault that came later has been seen by nobody. Without `forgive` the doubts
        about the reference stay, as before a reference run: nobody has said that the count is right.
        """


@runtime_checkable
class Repeating(Protocol):
    """A positioner that can tell, without an exchange, whether it still shows what it showed last."""

    def repeated_s(self, telemetry: Telemetry) -> float | None:
        """Return the time at which a look would show what this last one did; None where a new look has to be made."""


@runtime_checkable
class Recalling(Protocol):
    """A positioner that makes use of where its axes stood before the service was started anew."""

    def standing(self) -> tuple[float | None, float | None]:
        """Return where A and B stand by all that is known, in the `position_unit`; None where that is unknown."""

    def recall(self, a: float | None, b: float | None, doubt: str) -> None:
        """Take in, before the first `open`, what `standing` said at rest in the previous process, and its doubt.

        The doubt is a sentence, or empty; it stands as `Telemetry.reference_doubt` from then on.
        """


@dataclass(frozen=True, slots=True)
class SweptCurve:
    """One sweep of an electronic load over a photovoltaic module.

    Attributes
    ----------
    open_circuit_v
        Read with the input off, before the first step; NaN if it was beyond the load's range.
    voltage_v, current_a
        What was measured at each step, in the order of the steps; a step beyond the load's range has no point.
    stopped_why
        Why the sweep ended before its last step; empty if it did not.
    """

    open_circuit_v: float
    voltage_v: tuple[float, ...]
    current_a: tuple[float, ...]
    stopped_why: str = ""


SweepPlan = Callable[[float], Sequence[float]]
"""Returns the voltages [V] to step through, highest first, for an open-circuit voltage [V]; none for no sweep."""


class ElectronicLoad(Protocol):
    """Holds a module at one voltage after another and measures; leaves it in open circuit otherwise."""

    async def open(self) -> str:
        """Connect, identify, switch the input off and configure; return the instrument's identity."""

    async def close(self) -> None:
        """Switch the input off as far as that is possible, and release the instrument. Never raises."""

    async def sweep(self, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        """Measure one curve; the input is off again when this ends, however it ends.

        Parameters
        ----------
        plan
            Asked once, with the open-circuit voltage.
        stop_why
            Asked before each step; a sentence ends the sweep.
        """
