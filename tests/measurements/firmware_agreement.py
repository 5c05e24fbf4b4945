"""How far the simulated positioner agrees with the maker's firmware, and where not: the table of docs/hardware.md.

    python -m tests.measurements.firmware_agreement [SEED [COUNT [odd]]]

With `odd`, the sequences are bytes that nobody who knows the unit would send.

The script needs qemu-arm, and the firmware's build beside the repository. A sequence takes about half a second.
"""

import sys
from collections import Counter

from tests.firmware.odd_sequences import odd_sequence
from tests.firmware.peer import driver, missing
from tests.firmware.sequences import STATES, kind, run, sequence


def main(seed: int = 0, count: int = 300, *, odd: bool = False) -> None:
    if why := missing():
        sys.exit(why)
    module = driver()
    tried, differing = Counter(), Counter()
    for number in range(seed, seed + count):
        case = odd_sequence(number)[1] if odd else sequence(number)
        outcome = run(module, case)
        state = outcome.sequence.state
        tried[state] += 1
        if outcome.differences:
            differing[state] += 1
            print(f"{number} ({state}, {kind(case)}): {'; '.join(outcome.differences[:3])}")
            for step in outcome.sequence.steps:
                print(f"    {step}")
    print(f"{'state':16} {'sequences':>9} {'agree':>6}")
    for state in STATES:
        print(f"{state:16} {tried[state]:9} {tried[state] - differing[state]:6}")
    agree = count - differing.total()
    print(f"{'all':16} {count:9} {agree:6}   {100 * agree / count:.1f} %")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:3]), odd="odd" in sys.argv[3:])
