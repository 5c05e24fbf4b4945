"""`heliocube probe positioner` on a simulated unit that does not take each target."""

import asyncio
import json
from collections import Counter

import pytest

from daemon.base.clock import SystemClock
from daemon.base.timeloop import call_until
from daemon.config.settings import Settings
from daemon.rigs.probe_positioner import probe_positioner
from drivers.errors import RefusedError
from drivers.positioners.pozsol.wire import SEPARATOR, Field
from drivers.transcript import no_tap
from sim_drivers.pozsol.core import DEAF
from sim_drivers.pozsol.setup import AxisDrive, Setup


async def probed(host, say, tap=no_tap, **sections):
    settings = Settings.model_validate(
        {
            "instruments": {"kind": "real", "positioner": {"port": str(host.port.link), "telemetry_stale_s": 10.0}},
            **sections,
        }
    )
    return await probe_positioner(settings, SystemClock(), 0.5, 2.0, tap, say)


@pytest.mark.parametrize("for_good", [False, True])
def test_a_target_that_the_positioner_does_not_take_is_ordered_again_and_that_is_reported(positioner_host, for_good):
    said = []

    def told(text):
        return [line for line in said if text in line]

    async def scene():
        now = asyncio.get_running_loop().time
        async with positioner_host() as host:

            def say(line):
                said.append(line)
                if line.startswith("  A to ") and len(told("  A to ")) == 1:
                    host.core.inject(DEAF, now())
                elif "tried again" in line and not for_good:
                    host.core.repair(DEAF, now())

            return await probed(host, say)

    if for_good:
        with pytest.raises(RefusedError, match="did not take the target"):
            asyncio.run(scene())
        assert len(told("; it is tried again")) == 2
    else:
        assert asyncio.run(scene())["geometry_fits"]
        assert len(told("; it is tried again")) == 1
        assert [len(told(f"  {axis} to ")) for axis in "AB"] == [2, 2]


def test_limits_too_narrow_for_the_test_move_are_reported_before_anything_moves(positioner_host):
    said = []

    async def scene():
        async with positioner_host() as host:
            await probed(host, said.append, limits={"a_min_deg": -50.0, "b_min_deg": 88.5})

    with pytest.raises(
        RefusedError, match=r"B stands at 90.0 deg, and its limits, 88.5 to 90 deg, leave no room for 2 "
    ):
        asyncio.run(scene())
    assert not [line for line in said if line.startswith("  A to ")]


def test_an_axis_whose_count_is_in_doubt_is_not_moved(positioner_host):
    said = []

    async def scene():
        async with positioner_host() as host:
            host.core.inject("a_switch_closed", asyncio.get_running_loop().time())
            await probed(host, said.append)

    with pytest.raises(RefusedError, match=r"is not moved before it is homed, because of: .*switch"):
        asyncio.run(scene())
    assert not [line for line in said if line.startswith("  A to ")]


STOP = {"stop": {"why": "a cable", "by": "ana@lab", "since_utc_s": 1665705600.0}}
KEPT = [
    ("motion.json", {"homing": True}, r"has noted: homing was not finished.*'heliocube home' or 'heliocube clear'"),
    ("operator.json", STOP, r"stopped by ana@lab since 2022-10-14 00:00:00 UTC: a cable; 'heliocube auto' ends that"),
    ("operator.json", [], r"operator\.json cannot be read.*'heliocube auto' ends that"),
]


@pytest.mark.parametrize(("name", "content", "words"), KEPT)
def test_the_probe_does_not_move_when_saved_state_would_keep_the_service_from_moving(
    positioner_host, tmp_path, name, content, words
):
    (tmp_path / name).write_text(json.dumps(content))
    kept = {file: file.read_bytes() for file in tmp_path.iterdir()}
    received = []

    async def scene():
        async with positioner_host() as host:
            try:
                await probed(host, received.append, store={"directory": str(tmp_path)})
            finally:
                received.append(host.received.total())

    with pytest.raises(RefusedError, match=rf"is not moved.*{name}.*{words}"):
        asyncio.run(scene())
    assert received[-1] == 0
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == kept


def test_an_axis_that_still_moves_when_its_time_is_over_is_stopped_and_not_sent_back(positioner_host, monkeypatch):
    monkeypatch.setattr("daemon.rigs.probe_positioner._MOVE_WITHIN_S", 2.0)
    said, stands = [], []

    async def scene():
        now = asyncio.get_running_loop().time
        slow = Setup(drive=AxisDrive(speed_mm_s=1.0, acceleration_mm_s2=10.0, run_out_s=0.01))
        async with positioner_host(slow) as host:
            try:
                await probed(host, said.append)
            finally:
                stands.append(host.core.truth(now()))
                await asyncio.sleep(1.0)
                stands.append(host.core.truth(now()))

    with pytest.raises(RefusedError, match=r"still moves after 2 s, so it was stopped: a smaller --move-deg is enough"):
        asyncio.run(scene())
    assert not [line for line in said if line.startswith("  A to ")]
    assert stands[0] == stands[1]
    assert 0.0 < stands[0].a_deg < 1.5


@pytest.mark.parametrize("when", ["before", "on the way"])
def test_the_probe_moves_nothing_more_once_a_button_is_pressed_at_the_positioner(positioner_host, when):
    said, stands, told = [], [], Counter()

    def tap(direction, data):
        told[direction] += data.count(bytes((SEPARATOR, Field.STATUS)))

    async def scene():
        now = asyncio.get_running_loop().time
        # The unit reports its buttons every 3.24 s, or more seldom on a slow machine: this move takes far longer.
        slow = Setup(drive=AxisDrive(speed_mm_s=0.2, acceleration_mm_s2=10.0, run_out_s=0.01))
        async with positioner_host(slow) as host:

            async def press():
                if when == "on the way":
                    await call_until(0.02, lambda: host.core.truth(now()).a_deg >= 0.1)
                    # Press just after a report of the buttons: the unit stops by the press long before its next report.
                    before = told["<"]
                    await call_until(0.02, lambda: told["<"] > before)
                host.core.inject("buttons_both", now())

            pressing = asyncio.create_task(press())
            try:
                await probed(host, said.append, tap)
            finally:
                pressing.cancel()
                stands.append(host.core.truth(now()))
                await asyncio.sleep(1.0)
                stands.append(host.core.truth(now()))

    with pytest.raises(RefusedError, match="a button on its box is pressed, so somebody is there"):
        asyncio.run(scene())
    assert not [line for line in said if line.startswith("  A to ")]
    assert stands[0] == stands[1]
    assert stands[0].a_deg == 0.0 if when == "before" else 0.1 <= stands[0].a_deg < 1.9
