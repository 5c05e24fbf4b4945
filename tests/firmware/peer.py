"""The maker's firmware in an emulator, and the simulated unit, driven side by side in lock step."""

import importlib.util
import shutil
from dataclasses import dataclass
from types import ModuleType

from drivers.positioners.pozsol.wire import Field, TokenStream
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, Setup
from solar.frames import Angles
from tests.support import SHARED

FIRMWARE = SHARED / "firmware"
"""Beside the repository, as the measured data is."""
EMULATOR = "qemu-arm"
BUILD = "micro"
COUNTS_PER_MM = 75
_POLL_MS = 20
_SLOW_MM_S = 0.5
_SUN_DEG = 33.08
"""The sun's angles in the first minutes, as the firmware's own tracking computes them from its clock and place."""
_FIRMWARE_EVENTS = {
    "button out": ("buttons 2",),
    "button in": ("buttons 1",),
    "no button": ("buttons 0",),
    "supply low": ("supply 15",),
    "supply back": ("supply 24",),
    "halls of A dead": ("freeze 0 1",),
    "halls of B dead": ("freeze 1 1",),
    "halls of A alive": ("freeze 0 0",),
    "halls of B alive": ("freeze 1 0",),
    "overcurrent A": ("overcurrent 0 9", "step 40", "overcurrent 0 0"),
    "A's switch closed": ("stucklow 0 1",),
    "B's switch dead": ("stucklow 1 -1",),
    "slave": ("mode 5",),
    "replug": ("replug",),
}
_SIMULATED_EVENTS = {
    "button out": ("inject", "button"),
    "button in": ("inject", "button_in"),
    "no button": ("repair", "button"),
    "supply low": ("inject", "undervoltage"),
    "supply back": ("repair", "undervoltage"),
    "halls of A dead": ("inject", "a_hall_loss"),
    "halls of B dead": ("inject", "b_hall_loss"),
    "halls of A alive": ("repair", "a_hall_loss"),
    "halls of B alive": ("repair", "b_hall_loss"),
    "overcurrent A": ("inject", "a_overcurrent"),
    "A's switch closed": ("inject", "a_switch_closed"),
    "B's switch dead": ("inject", "b_switch_open"),
    "slave": ("inject", "slave_standby"),
    "replug": ("replug", ""),
}
_EVENT_MS = {"overcurrent A": 40}


def missing() -> str | None:
    """Return in one sentence what is missing to run the firmware, or None."""
    if shutil.which(EMULATOR) is None:
        return f"{EMULATOR} is not here (Debian's qemu-user): the tests against the maker's firmware are left out"
    if not (FIRMWARE / f"firmware_{BUILD}").exists():
        return f"the maker's firmware is not at {FIRMWARE}: the tests against it are left out"
    return None


def driver() -> ModuleType:
    """Return the module that runs the firmware in lock step, as it lies beside the repository."""
    spec = importlib.util.spec_from_file_location("firmware_in_lock_step", FIRMWARE / "fw.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Look:
    """What one unit shows of itself at one time.

    Attributes
    ----------
    position_mm, destination_mm
        Of A and B.
    motion
        Of A and B: -1 inwards, 0 standing, 1 outwards.
    status
        The word of field 136.
    """

    position_mm: tuple[float, float]
    destination_mm: tuple[float, float]
    motion: tuple[int, int]
    status: int


def _direction(velocity_mm_s: float) -> int:
    return 0 if abs(velocity_mm_s) < _SLOW_MM_S else 1 if velocity_mm_s > 0 else -1


class Firmware:
    """The maker's firmware: powered up and provisioned, 20 ms before it looks at its input."""

    def __init__(self, module: ModuleType, a_deg: float, b_deg: float) -> None:
        self.unit = module.Unit(BUILD)
        module.provision(self.unit, a_deg, b_deg)
        self.step(-self.unit.state()["ms"] % _POLL_MS)

    def step(self, ms: int) -> None:
        """Let time pass."""
        if ms:
            self.unit.step(ms)

    def feed(self, packet: bytes) -> None:
        """Send bytes."""
        self.unit.usb(packet, 0)

    def cause(self, event: str) -> None:
        """Do something to the unit other than a command."""
        for line in _FIRMWARE_EVENTS[event]:
            if line.startswith("step "):
                self.unit.step(int(line[5:]))
            else:
                self.unit.cmd(line)

    def look(self) -> Look:
        """Return what it shows now."""
        state = self.unit.state()
        axes = state["axes"]
        return Look(
            tuple(axis["pos"] / COUNTS_PER_MM for axis in axes),
            tuple(axis["target"] / COUNTS_PER_MM for axis in axes),
            tuple(_direction(axis["vel"] / COUNTS_PER_MM) for axis in axes),
            state["status"] & 0xFFFF_FFFF,
        )

    def twin(self) -> "Simulated":
        """Return a simulated unit that stands where this one stands, with the same bytes left over in its input."""
        return Simulated.like(*self.stands())

    def stands(self) -> tuple[list[float], str]:
        """Return where it stands, in counts from its low ends, and the bytes left over in its input."""
        state = self.unit.state()
        return [axis["true"] for axis in state["axes"]], state["rx"]

    def close(self) -> None:
        """End the emulator."""
        self.unit.close()
        self.unit.p.stdin.close()
        self.unit.p.stdout.close()


class Simulated:
    """The simulated unit, with mechanics like the firmware's."""

    def __init__(self, a_mm: float, b_mm: float) -> None:
        start = Angles(A_ACTUATOR.angle_deg(a_mm), B_ACTUATOR.angle_deg(b_mm))
        sun = Angles(_SUN_DEG, _SUN_DEG)
        setup = Setup(start=start, high_switches=False, own_target=lambda _now: sun)
        self.core = PositionerCore(0.0, setup)
        self._ms = 0

    @classmethod
    def like(cls, true_counts: list[float], left_over_hex: str) -> "Simulated":
        """Return one that stands so many counts from its low ends, with bytes left over in its input."""
        twin = cls(*(count / COUNTS_PER_MM for count in true_counts))
        left_over = bytes.fromhex(left_over_hex)
        twin.core._buffer[: len(left_over)] = left_over
        return twin

    @property
    def _now(self) -> float:
        return self._ms / 1000

    def step(self, ms: int) -> None:
        """Let time pass."""
        self._ms += ms
        self.core.advance(self._now)

    def feed(self, packet: bytes) -> None:
        """Send bytes."""
        self.core.feed(packet, self._now)

    def cause(self, event: str) -> None:
        """Do something to the unit other than a command."""
        kind, fault = _SIMULATED_EVENTS[event]
        if kind == "replug":
            self.core.enumerate_usb(self._now)
        elif kind == "inject":
            self.core.inject(fault, self._now)
        elif kind == "repair":
            self.core.repair(fault, self._now)
        self.step(_EVENT_MS.get(event, 0))

    def look(self) -> Look:
        """Return what it shows now."""
        fields = dict(TokenStream().feed(self.core.live_screens(self._now) + b"$"))
        axes = self.core._unit.axes.values()
        return Look(
            (float(fields[Field.A_POSITION]), float(fields[Field.B_POSITION])),
            (float(fields[Field.A_DESTINATION]), float(fields[Field.B_DESTINATION])),
            tuple(_direction(axis.velocity_mm_s(self._now)) for axis in axes),
            int(fields[Field.STATUS]) & 0xFFFF_FFFF,
        )
