"""The simulated unit beside the maker's firmware: the same bytes to both, in lock step.

Most of what the firmware does is recorded (tests/firmware/recorded.py): to emulate it through
eighty sequences took half a minute of a processor, and it does the same every time.
"""

from collections import Counter

import pytest

from tests.firmware.odd_sequences import odd_sequence
from tests.firmware.recorded import MAKERS, SEEDS, Recorded, fingerprint, firmware, heard
from tests.firmware.sequences import compare, kind, run, sequence

_AGREEMENT = 0.95
_ANEW = "record anew: python -m tests.firmware.recorded"


@pytest.mark.parametrize("which", MAKERS)
def test_sequences_agree_in_position_destination_motion_and_status(recorded, record_property, which):
    _, pages = recorded[which]
    outcomes = []
    for seed in SEEDS:
        case = MAKERS[which](seed)
        assert pages[seed]["case"] == fingerprint(case), _ANEW
        firmware = Recorded(pages[seed])
        outcomes.append(compare(firmware, firmware.twin(), case))
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
    for seed in SEEDS[::10]:
        case = MAKERS[which](seed)
        page, _ = heard(lock_step, case)
        assert {"seed": seed, **page} == pages[seed], f"{_ANEW}, if the firmware has changed"


@pytest.mark.parametrize("seed", [50079, 3228423247, 910204, 910209, 910088, 910110])
def test_sequences_that_once_differed_agree(lock_step, seed):
    assert run(lock_step, sequence(seed)).differences == []


@pytest.mark.parametrize("seed", [16, 51, 100])
def test_odd_sequences_that_once_differed_agree(lock_step, seed):
    assert run(lock_step, odd_sequence(seed)[1]).differences == []
