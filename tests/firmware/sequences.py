"""Seeded sequences of packets and events for a positioner, and where two units disagree about them."""

import random
from dataclasses import dataclass, field
from types import ModuleType

from tests.firmware.peer import Firmware, Look, Simulated

STATES = (
    "idle",
    "A moves",
    "B moves",
    "both ordered",
    "homing A",
    "homing B",
    "run out",
    "fault",
    "undervoltage",
    "own tracking",
    "after a button",
    "button held",
    "slave",
    "dead halls",
    "replugged",
    "arriving",
    "homed",
    "bad switch",
)
_SHORT_MS, _LONG_MS = 150, 4000
_TOLERANCE_MM = 0.5
_LATE_MS = 120
"""How much earlier or later than the other one, one unit may change what it shows."""
_LOOKS = 3
_FLICKERS, _FLICKER_MS = 3, 3
"""While an axis runs out, the firmware now and then shows the other direction for a millisecond: then look again."""
_ORDERS = {"A": (b"$,", b"$.", b"$92", b"$94", b"$95"), "B": (b"$0", b"$2", b"$91", b"$93", b"$96")}
STATUS_BITS = 0x91FF_FFFF & ~(1 << 10 | 1 << 14 | 1 << 30) | 1 << 25
"""The bits that the driver reads: faults, reset, button, motion, homing, switches, pulses, tracking, destinations."""


@dataclass(frozen=True)
class Step:
    """Packets that are sent at once, or an event; then a wait [ms], and a look."""

    packets: tuple[bytes, ...] = ()
    gap_ms: int = 0
    event: str = ""
    wait_ms: int = 0


@dataclass(frozen=True)
class Sequence:
    """One case: the state that it begins in, and what happens."""

    seed: int
    state: str
    a_deg: float
    b_deg: float
    steps: tuple[Step, ...]


@dataclass
class Outcome:
    """Where the two units disagree: in which quantity, and after which step."""

    sequence: Sequence
    differences: list[str] = field(default_factory=list)


def sequence(seed: int) -> Sequence:
    """Return the case of a seed."""
    draw = random.Random(seed)
    state = draw.choice(STATES)
    a_deg, b_deg = start_angles(state, draw)
    steps = [*prelude(state, a_deg, b_deg, draw)]
    for _ in range(draw.randint(1, 4)):
        wait_ms = draw.choice((draw.randint(_SHORT_MS, 900), draw.randint(_SHORT_MS, _LONG_MS)))
        steps.append(Step(_packets(draw), draw.choice((0, 0, 5, 25, 60)), wait_ms=wait_ms))
    steps.append(Step(wait_ms=draw.randint(1000, 6000)))
    return Sequence(seed, state, a_deg, b_deg, tuple(steps))


def kind(case: Sequence) -> str:
    """Return which documented difference (docs/hardware.md) a case can show, by its state and its commands."""
    packets = b"".join(packet for step in case.steps for packet in step.packets)
    if case.state == "button held":
        return "a button that is held"
    if case.state == "own tracking" or b"$8Y" in packets or b"$8y" in packets:
        return "own tracking"
    if case.state == "arriving":
        return "a target a few impulses away"
    orders = {axis: sum(packets.count(code) for code in codes) for axis, codes in _ORDERS.items()}
    if max(orders.values()) > 1:
        return "a reversal at the first impulse"
    return "of no documented kind"


def start_angles(state: str, draw: random.Random) -> tuple[float, float]:
    """Return where A and B stand at first [deg]."""
    near_low = state in ("homed", "bad switch")
    return draw.uniform(-51.5, -48 if near_low else 48), draw.uniform(13.5, 16 if near_low else 89)


def run(module: ModuleType, case: Sequence) -> Outcome:
    """Give a case to a fresh firmware and to a fresh simulated unit on equal mechanics."""
    firmware = Firmware(module, case.a_deg, case.b_deg)
    try:
        return compare(firmware, firmware.twin(), case)
    finally:
        firmware.close()


def compare(firmware: Firmware, simulated: Simulated, case: Sequence) -> Outcome:
    """Give a case to both units and return where they disagree."""
    outcome = Outcome(case)
    for number, step in enumerate(case.steps):
        for unit in (firmware, simulated):
            if step.event:
                unit.cause(step.event)
            for packet in step.packets:
                unit.feed(packet)
                unit.step(step.gap_ms)
        firmware.step(step.wait_ms)
        simulated.step(step.wait_ms - _LATE_MS)
        shown = [firmware.look()]
        for _ in range(_FLICKERS):
            firmware.step(_FLICKER_MS)
            shown.append(firmware.look())
        looks = [simulated.look()]
        for _ in range(2 * _LOOKS):
            simulated.step(_LATE_MS // _LOOKS)
            looks.append(simulated.look())
        firmware.step(_LATE_MS - _FLICKERS * _FLICKER_MS)
        outcome.differences += [f"step {number}: {text}" for text in _differences(shown, looks)]
    return outcome


def _differences(all_shown: list[Look], looks: list[Look]) -> list[str]:
    found = []
    shown = all_shown[0]
    now = looks[_LOOKS]
    for index, axis in enumerate("AB"):
        for name in ("position_mm", "destination_mm"):
            theirs, ours = getattr(shown, name)[index], [getattr(look, name)[index] for look in looks]
            if not (min(ours) - _TOLERANCE_MM <= theirs <= max(ours) + _TOLERANCE_MM):
                found.append(f"{axis} {name} {theirs:.2f}, simulated {getattr(now, name)[index]:.2f}")
        if shown.motion[index] not in [look.motion[index] for look in looks]:
            found.append(f"{axis} motion {shown.motion[index]}, simulated {now.motion[index]}")
    ours, theirs = ({look.status & STATUS_BITS for look in side} for side in (looks, all_shown))
    if any({word >> bit & 1 for word in ours}.isdisjoint(word >> bit & 1 for word in theirs) for bit in range(32)):
        found.append(f"status {shown.status & STATUS_BITS:x}, simulated {now.status & STATUS_BITS:x}")
    return found


def prelude(state: str, a_deg: float, b_deg: float, draw: random.Random) -> list[Step]:
    """Return the steps that bring a unit into a state."""
    a = Step((_target(46, draw),), wait_ms=draw.randint(_SHORT_MS, _LONG_MS))
    b = Step((_target(50, draw),), wait_ms=draw.randint(_SHORT_MS, _LONG_MS))
    home_a, home_b = (Step((packet,), wait_ms=draw.randint(_SHORT_MS, 6000)) for packet in (b"$95\r", b"$96\r"))
    stop = Step((b"$9s\r",), wait_ms=draw.randint(_SHORT_MS, 500))
    axis, wait_ms = draw.choice("AB"), draw.randint(_SHORT_MS, 3000)
    moving = a if axis == "A" else b
    home = draw.choice((home_a, home_b))
    near = b"$,%.1f\r" % (a_deg + draw.uniform(-4, 4)), b"$0%.1f\r" % (b_deg + draw.uniform(-4, 4))
    return {
        "idle": [],
        "A moves": [a],
        "B moves": [b],
        "both ordered": [Step(a.packets, wait_ms=_SHORT_MS), b],
        "homing A": [home_a],
        "homing B": [home_b],
        "run out": [moving, stop],
        "fault": [a, Step(event="overcurrent A", wait_ms=wait_ms)],
        "undervoltage": [
            draw.choice((moving, home_a, home_b)),
            Step(event="supply low", wait_ms=wait_ms),
            *draw.choice(([], [Step(event="supply back", wait_ms=draw.randint(_SHORT_MS, 7000))])),
        ],
        "own tracking": [Step((b"$8Y\r",), wait_ms=wait_ms)],
        "after a button": [
            draw.choice((moving, Step(wait_ms=_SHORT_MS))),
            Step(event=draw.choice(("button out", "button in")), wait_ms=draw.randint(_SHORT_MS, 2000)),
            Step(event="no button", wait_ms=draw.randint(_SHORT_MS, 1000)),
        ],
        "button held": [Step(event=draw.choice(("button out", "button in")), wait_ms=draw.randint(500, 2000))],
        "slave": [Step(event="slave", wait_ms=wait_ms)],
        "dead halls": [moving, Step(event=f"halls of {axis} dead", wait_ms=wait_ms)],
        "arriving": [Step(near[: draw.randint(1, 2)], 60, wait_ms=draw.randint(300, 9000))],
        "homed": [home, *draw.choice(([], [Step(wait_ms=2000)]))],
        "bad switch": [
            Step(event=draw.choice(("A's switch closed", "B's switch dead")), wait_ms=_SHORT_MS),
            draw.choice((home, moving)),
        ],
        "replugged": [draw.choice((moving, Step(wait_ms=_SHORT_MS))), Step(event="replug", wait_ms=_SHORT_MS)],
    }[state]


def _packets(draw: random.Random) -> tuple[bytes, ...]:
    kind = draw.choices(("one", "joined", "split", "two", "garbage", "oversized", "unclosed"), (60, 6, 6, 10, 8, 5, 5))[
        0
    ]
    command = _command(draw)
    if kind == "joined":
        return (command + _command(draw),)
    if kind == "split":
        at = draw.randint(1, max(len(command) - 1, 1))
        return command[:at], command[at:]
    if kind == "two":
        return command, _command(draw)
    if kind == "garbage":
        noise = bytes(draw.choice(b" abcxyz0123456789.-+\r\n\t") for _ in range(draw.randint(1, 20)))
        return (draw.choice((noise, noise + command, command[:2] + noise, b"$", b"")) or b"\r",)
    if kind == "oversized":
        return (command.ljust(draw.choice((63, 64, 70)), b" ") + _command(draw),)
    if kind == "unclosed":
        return command.rstrip(b"\r"), _command(draw).rstrip(b"\r")
    return (command,)


def _command(draw: random.Random) -> bytes:
    code = draw.choices((44, 48, 46, 50, 56, 57, 136), (20, 20, 10, 10, 6, 26, 8))[0]
    if code in (44, 48, 46, 50):
        return _target(code, draw)
    if code == 56:
        return b"$8N\r"
    if code == 136:
        return draw.choice((b"$\x880\r", b"$\x88\r"))
    return b"$9" + draw.choice((b"s", b"s", b"5", b"6", b"1", b"2", b"3", b"4", b"7")) + b"\r"


def _target(code: int, draw: random.Random) -> bytes:
    largest = {44: (-60, 60), 48: (10, 95), 46: (0, 380), 50: (0, 290)}[code]
    number = draw.uniform(*largest)
    text = f"{number:.4f}" if code in (44, 48) else f"{number:.0f}"
    odd = draw.choice(
        ("-5", "-400", "400", "99999", "nan", "inf", "1e1", "0x10", "\t20", "", "abc", "1e30", "-0", " 7")
    )
    return b"$%c" % code + (odd if draw.random() < 0.1 else text).encode() + b"\r"
