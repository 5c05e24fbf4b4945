"""The simulated unit beside the maker's firmware: the same bytes to both, in lock step."""

from collections import Counter

import pytest

from tests.firmware.odd_sequences import odd_sequence
from tests.firmware.sequences import kind, run, sequence

_AGREEMENT = 0.95
# Always the same, so that a red test is a change; tests/measurements/firmware_agreement.py draws others.
_FIRST, _COUNT = 1_000_000, 40
_MAKERS = {"ordinary": sequence, "odd": lambda seed: odd_sequence(seed)[1]}


@pytest.mark.parametrize("which", _MAKERS)
def test_sequences_agree_in_position_destination_motion_and_status(lock_step, record_property, which):
    outcomes = [run(lock_step, _MAKERS[which](_FIRST + number)) for number in range(_COUNT)]
    different = [outcome for outcome in outcomes if outcome.differences]
    told = "\n".join(
        f"{one.sequence.seed} ({one.sequence.state}, {kind(one.sequence)}): {one.differences}" for one in different
    )
    print(f"{which} seeds from {_FIRST}: {len(outcomes) - len(different)} of {len(outcomes)} sequences agree\n{told}")
    record_property("agreement", 1 - len(different) / len(outcomes))
    assert len(different) <= (1 - _AGREEMENT) * len(outcomes), told
    assert max(Counter(one.sequence.state for one in different).values(), default=0) <= len(outcomes) / 20, told


@pytest.mark.parametrize("seed", [50079, 3228423247, 910204, 910209, 910088, 910110])
def test_sequences_that_once_differed_agree(lock_step, seed):
    assert run(lock_step, sequence(seed)).differences == []


@pytest.mark.parametrize("seed", [16, 51, 100])
def test_odd_sequences_that_once_differed_agree(lock_step, seed):
    assert run(lock_step, odd_sequence(seed)[1]).differences == []
