"""What the self-tests of a configuration can see of the multiplexer's address lines.

A short-circuited input proves a line only if the stuck line leads to another input that reads something. One input
sees each line stuck one way, the way that changes its own address; an input of the opposite address sees the others.
"""

from collections.abc import Callable, Iterator

from daemon.base.records import FACES
from daemon.config.rules import SELF_TESTS, has_multiplexer
from daemon.config.settings import Settings

_PAGE = "see docs/hardware.md, Wiring"


def self_test_gaps(settings: Settings) -> list[str]:
    """Return in sentences which stuck line no self-test can see, and what has to be wired for the others."""
    if not has_multiplexer(settings):
        return []
    cube = settings.cube
    tests = [channel for name in SELF_TESTS if (channel := getattr(cube, name)) is not None]
    if not tests:
        return [f"no self-test: a stuck address line is only found in daylight, by comparing the faces; {_PAGE}"]
    faces = {getattr(cube, name).channel for name in FACES}
    unseen, spare = [], set()
    for name, stuck in _faults(settings.instruments.multiplexer.addresses):
        led_to = {stuck(test) for test in tests} - set(tests) - {None}
        if not led_to:
            unseen.append(name)
        elif not led_to & faces:
            spare |= led_to
    found = []
    if unseen:
        found.append(f"the self-test does not see {', '.join(unseen)}; {_PAGE}")
    if spare:
        inputs = ", ".join(str(channel) for channel in sorted(channel for channel in spare if channel is not None))
        found.append(
            f"the self-test needs something to read at input {inputs}: wire it in parallel with a face; {_PAGE}"
        )
    return found


def _faults(addresses: tuple[int, ...]) -> Iterator[tuple[str, Callable[[int], int | None]]]:
    """Yield each fault in words, with a function from the input that is selected to the one that is then read."""
    lines = [bit for bit in range(max(addresses).bit_length()) if any(address >> bit & 1 for address in addresses)]
    input_of = {address: channel for channel, address in enumerate(addresses)}

    def forced(bits: int, *, high: bool) -> Callable[[int], int | None]:
        return lambda channel: input_of.get(addresses[channel] | bits if high else addresses[channel] & ~bits)

    for bit in lines:
        yield f"line {bit} stuck low", forced(1 << bit, high=False)
        yield f"line {bit} stuck high", forced(1 << bit, high=True)
    yield "a port without supply (all lines high)", forced(sum(1 << bit for bit in lines), high=True)
