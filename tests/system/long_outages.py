"""Plugs out for longer than a minute, in each phase. Not collected by itself: a quarter of an hour of waiting.

Run with ``python -m pytest tests/system/long_outages.py -s``.
"""

import pytest

from .rig import PHASES, ROLES

OUT_S = 70.0
pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]


@pytest.mark.parametrize("device", ROLES)
def test_a_plug_that_is_out_for_long_is_survived_at_rest(start_rig, device):
    rig = start_rig()
    rig.settle()
    for phase in PHASES:
        phase(rig, device)
        load = rig.survive(device, OUT_S, phase.__name__)
        print(f"{device} {phase.__name__}: {load:.1%} of a processor while it was out for {OUT_S:g} s")
        assert load < 0.2
    rig.new_sky()
    rig.settle()
    assert rig.service.exit_code is None
