"""Plugs out for longer than a minute, in each phase. Not collected by itself: half an hour of waiting.

Run with ``python -m pytest tests/system/long_outages.py -s``.
"""

import pytest

from tests.system.processes import wait_until
from tests.system.rig import HIGH_SUN, PHASES, ROLES, Rig, brisk

OUT_S = 70.0
pytestmark = pytest.mark.system


@pytest.mark.parametrize("device", ROLES)
def test_the_service_survives_a_plug_out_for_70_s_in_each_phase_with_little_processor_load(start_rig, device):
    rig = start_rig()
    rig.settle()
    for phase in PHASES:
        phase(rig, device)
        load, back_s = rig.survive(device, OUT_S, phase.__name__)
        report(device, phase.__name__, load, back_s)
    rig.new_sky()
    rig.settle()
    assert rig.service.exit_code is None


@pytest.mark.parametrize("device", ROLES)
def test_the_service_waits_with_little_processor_load_for_a_plug_out_for_70_s_before_the_start(
    tmp_path, start_bench, start_service, device
):
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    bench.ask("unplug", device)
    rig = Rig(bench, start_service(bench.config))
    wait_until(lambda: rig.lines(" is down: ") == 1, rig.service.log)
    report(device, "before the start", rig.load(OUT_S), rig.comes_back(device))


@pytest.mark.parametrize("device", ROLES)
def test_the_service_waits_with_little_processor_load_for_a_plug_pulled_for_70_s_at_the_start(start_rig, device):
    rig = start_rig()
    wait_until(lambda: "real instruments" in rig.service.log(), rig.service.log)
    rig.bench.ask("unplug", device)
    report(device, "at the start", rig.load(OUT_S), rig.comes_back(device))


def report(device, phase, load, back_s):
    print(f"{device} {phase}: {load:.1%} of a processor in {OUT_S:g} s without it, tracking {back_s:.1f} s after")
    assert load < 0.2
    assert back_s < 15.0
