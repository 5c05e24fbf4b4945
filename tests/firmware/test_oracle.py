"""The simulated unit beside the maker's firmware: the same bytes to both, in lock step."""

import random
import time
from collections import Counter

from tests.firmware.sequences import run, sequence

_AGREEMENT = 0.95
_TIME_S = 60.0
_FEWEST, _MOST = 40, 300


def test_fresh_sequences_agree_in_position_destination_motion_and_status(lock_step, record_property):
    start = random.SystemRandom().randrange(1 << 32)
    outcomes, until_s = [], time.monotonic() + _TIME_S
    while len(outcomes) < _FEWEST or (len(outcomes) < _MOST and time.monotonic() < until_s):
        outcomes.append(run(lock_step, sequence(start + len(outcomes))))
    different = [outcome for outcome in outcomes if outcome.differences]
    told = "\n".join(f"{one.sequence.seed} ({one.sequence.state}): {one.differences}" for one in different)
    print(f"seeds from {start}: {len(outcomes) - len(different)} of {len(outcomes)} sequences agree\n{told}")
    record_property("agreement", 1 - len(different) / len(outcomes))
    assert len(different) <= (1 - _AGREEMENT) * len(outcomes), told
    assert max(Counter(one.sequence.state for one in different).values(), default=0) <= len(outcomes) / 20, told
