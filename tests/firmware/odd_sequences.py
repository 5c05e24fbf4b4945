"""What somebody might send without having read the unit's manual: seeded sequences of odd bytes, in every state."""

import random
from dataclasses import replace

from tests.firmware.sequences import STATES, Sequence, Step, prelude, start_angles

KINDS = (
    "long garbage",
    "dollar inside",
    "high codes",
    "jogs and stops",
    "five ms apart",
    "clear while moving",
    "own tracking on and off",
    "odd numbers",
)
_SHORT_MS = (150, 900)
_ODD_NUMBERS = (
    b"1e2", b"-1e1", b"1e-30", b"1e38", b"1e39", b"-1e39", b"0x1F", b"-0x10", b"0x", b"0x1p4", b"+17", b"--5", b"+-3",
    b"1.5.5", b".5", b"5.", b".", b"-.5", b"-", b"+", b"4294967296", b"4294967301", b"2147483647", b"2147483648",
    b"-2147483648", b"00000000000000000000033", b"33.0000000000000000000000001", b"1e", b"1e+", b"2e1x", b"NAN",
    b"-inf", b"infinity", b" \t 21", b"21 ", b"2 1", b"21,5", b"1E1", b"1_0", b"\x0021", b"9" * 50,
)  # fmt: skip
_HIGH = (0x80, 0x81, 0x85, 0x87, 0x89, 0x90, 0xA0, 0xB9, 0xC3, 0xFF)


def odd_sequence(seed: int) -> tuple[str, Sequence]:
    """Return the kind and the odd case of a seed."""
    draw = random.Random(f"odd {seed}")
    kind, state = draw.choice(KINDS), draw.choice(STATES)
    a_deg, b_deg = start_angles(state, draw)
    steps = [*prelude(state, a_deg, b_deg, draw)]
    for _ in range(draw.randint(1, 3)):
        steps += _steps(kind, draw)
    steps.append(Step(wait_ms=draw.randint(1000, 6000)))
    return kind, Sequence(seed, state, a_deg, b_deg, tuple(steps))


def _steps(kind: str, draw: random.Random) -> list[Step]:
    wait_ms = draw.randint(*_SHORT_MS) if draw.random() < 0.5 else draw.randint(900, 4000)
    step = Step(wait_ms=wait_ms)
    if kind == "long garbage":
        noise = bytes(draw.randrange(256) for _ in range(draw.choice((64, 100, 200, 500))))
        if noise.startswith(b"$"):
            noise = b"!" + noise[1:]
        cut = [noise[at : at + 64] for at in range(0, len(noise), 64)]
        return [replace(step, packets=(*cut, _target(draw)), gap_ms=draw.choice((0, 5, 25)))]
    if kind == "dollar inside":
        inside = draw.choice(
            (b"$,1$2\r", b"$.1$50\r", b"$,$,10\r", b"$$,10\r", b"$9$s\r", b"$9s$95\r", b"$.20$9s\r", b"$8$N\r")
        )
        return [replace(step, packets=(inside,))]
    if kind == "high codes":
        code = draw.choice(_HIGH)
        return [replace(step, packets=(b"$%c%d\r" % (code, draw.randrange(100)), _target(draw)), gap_ms=25)]
    if kind == "jogs and stops":
        packets = tuple(
            draw.choice((b"$91\r", b"$92\r", b"$93\r", b"$94\r", b"$9s\r")) for _ in range(draw.randint(2, 6))
        )
        return [replace(step, packets=packets, gap_ms=draw.choice((20, 40, 60, 150, 260, 300)))]
    if kind == "five ms apart":
        return [replace(step, packets=(_any(draw), _any(draw)), gap_ms=5)]
    if kind == "clear while moving":
        return [Step((_target(draw),), wait_ms=draw.randint(150, 1500)), replace(step, packets=(b"$\x880\r",))]
    if kind == "own tracking on and off":
        packets = tuple(
            draw.choice((b"$8Y\r", b"$8N\r", b"$8y\r", b"$8n\r", b"$8\r")) for _ in range(draw.randint(1, 3))
        )
        return [replace(step, packets=packets, gap_ms=draw.choice((30, 100, 400)))]
    return [replace(step, packets=(b"$%c" % draw.choice(b",0.2") + draw.choice(_ODD_NUMBERS) + b"\r",))]


def _target(draw: random.Random) -> bytes:
    code, low, high = draw.choice(((b",", -55, 55), (b"0", 12, 92), (b".", 0, 380), (b"2", 0, 290)))
    return b"$" + code + str(draw.randint(low, high)).encode() + b"\r"


def _any(draw: random.Random) -> bytes:
    return draw.choice((_target(draw), b"$9s\r", b"$95\r", b"$96\r", b"$8N\r", b"$\x880\r", b"$97\r", b"$91\r"))
