"""The simulated unit beside the maker's firmware: the same bytes to both, in lock step.

Most of what the firmware does is recorded (tests/firmware/recorded.py): emulating it through eighty sequences took half
a minute of a processor, and it does the same every time.
"""

from collections import Counter

import pytest

from tests.firmware.recorded import MAKERS, ONCE_DIFFERED, SEEDS, Recorded, fingerprint, firmware, heard
from tests.firmware.sequences import compare, kind

_AGREEMENT = 0.95
_ANEW = "record anew: python -m tests.firmware.recorded"


def agreement(recorded, which, seed):
    """Return where the simulated unit differs from what the firmware did."""
    case, page = MAKERS[which](seed), recorded[which][1][seed]
    assert page["case"] == fingerprint(case), _ANEW
    firmware = Recorded(page)
    return compare(firmware, firmware.twin(), case)


@pytest.mark.parametrize("which", MAKERS)
def test_simulated_unit_and_firmware_agree_in_position_destination_motion_and_status(recorded, record_property, which):
    outcomes = [agreement(recorded, which, seed) for seed in SEEDS]
    different = [outcome for outcome in outcomes if outcome.differences]
    told = "\n".join(
        f"{one.sequence.seed} ({one.sequence.state}, {kind(one.sequence)}): {one.differences}" for one in different
    )
    print(f"{which} seeds from {SEEDS[0]}: {len(outcomes) - len(different)} of {len(outcomes)} sequences agree\n{told}")
    record_property("agreement", 1 - len(different) / len(outcomes))
    assert len(different) <= (1 - _AGREEMENT) * len(outcomes), told
    assert max(Counter(one.sequence.state for one in different).values(), default=0) <= len(outcomes) / 20, told


@pytest.mark.parametrize("which", MAKERS)
def test_the_firmware_does_what_is_recorded(lock_step, recorded, which):
    known, pages = recorded[which]
    assert known == firmware(), _ANEW
    for seed in SEEDS[::20]:
        case = MAKERS[which](seed)
        page, _ = heard(lock_step, case)
        assert {"seed": seed, **page} == pages[seed], f"{_ANEW}, if the firmware has changed"


@pytest.mark.parametrize(("which", "seed"), [(which, seed) for which, seeds in ONCE_DIFFERED.items() for seed in seeds])
def test_sequences_on_which_simulated_unit_and_firmware_once_differed_now_agree(recorded, which, seed):
    assert agreement(recorded, which, seed).differences == []
