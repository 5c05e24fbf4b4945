"""The service manager's watchdog is answered only while the work goes on."""

import asyncio
import contextlib
import socket

import pytest

from daemon.base.process import SystemdNotifier
from daemon.base.records import Mode, Move, MoveOutcome
from daemon.base.timeloop import VirtualTimeLoop
from daemon.service.health import LoopWatch, Watchdog
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.support.motion import STOP_PACKET, commands_sent


@pytest.fixture
def manager(tmp_path):
    """A service manager's socket and the notifier that writes to it; `heard` listens for a while."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "20000000"}

        async def heard(during_s):
            # The kernel keeps only a few datagrams, so they are fetched as they come.
            lines = []
            for _ in range(round(during_s / 10)):
                await asyncio.sleep(10)
                with contextlib.suppress(BlockingIOError):
                    while True:
                        lines += listening.recv(4096).decode().split("\n")
            return lines

        yield SystemdNotifier(environment, 1), heard


def watch(rig, notifier):
    service = rig.service
    return Watchdog(rig.clock, notifier, service.trackers, service.acquisition, speed=1.0)


@pytest.mark.parametrize("part", ["control", "acquisition"])
def test_watchdog_pings_end_when_control_or_acquisition_hangs(run_rig, manager, part):
    notifier, heard = manager

    async def scenario(rig):
        watching = asyncio.create_task(watch(rig, notifier).run())
        assert (await heard(60)).count("WATCHDOG=1") >= 5
        if part == "control":
            rig.control.tick = lambda: None
        else:
            rig.multiplexer.select = lambda _channel: asyncio.sleep(1e6)
        await heard(60)
        lines = await heard(120)
        assert "WATCHDOG=1" not in lines
        assert any(line.startswith("STATUS=") and "for" in line for line in lines)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    run_rig(scenario)


def test_watchdog_pings_go_on_while_the_voltmeter_and_the_positioner_are_down(run_rig, manager):
    notifier, heard = manager

    async def scenario(rig):
        watching = asyncio.create_task(watch(rig, notifier).run())
        rig.cables.voltmeter.link_up = rig.cables.positioner.link_up = False
        await heard(120)
        assert (await heard(120)).count("WATCHDOG=1") >= 11
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    run_rig(scenario)


def test_an_axis_that_runs_past_its_target_is_stopped_and_ends_the_move_in_fault(run_rig, monkeypatch):
    async def scenario(rig):
        sent = commands_sent(rig, monkeypatch)
        await rig.until_mode(Mode.FAULT, 300)
        assert "beyond its target" in rig.control.why
        assert sent[-1][1].startswith(STOP_PACKET)
        stands = rig.truth()
        # Not stopped, it would run on for 25 mm, which is far more.
        assert abs(stands.a_deg - rig.records_of(Move)[-1].target_a_deg) < 3.0
        await asyncio.sleep(20)
        assert rig.truth() == stands

    rig = run_rig(scenario, setup=Setup(drive=AxisDrive(overshoot_mm=25.0)))
    assert MoveOutcome.OVERSHOT in [move.outcome for move in rig.records_of(Move)]


class HeldUpClock:
    """The loop's clock, which a test lets run on as if something had held the loop up."""

    held_s = 0.0

    def monotonic(self):
        return asyncio.get_running_loop().time() + self.held_s


def test_the_lateness_of_the_event_loop_is_measured_and_its_worst_value_is_of_the_last_minutes():
    async def scenario():
        clock = HeldUpClock()
        watch = LoopWatch(clock, speed=2.0)
        watching = asyncio.create_task(watch.run())
        await asyncio.sleep(10.1)
        assert (watch.state.worst_s, watch.state.counts) == (pytest.approx(0.0, abs=1e-9), (50,) * 8)
        clock.held_s += 0.06
        await asyncio.sleep(0.2)
        clock.held_s += 0.6
        await asyncio.sleep(0.2)
        state = watch.state
        assert state.worst_s == pytest.approx(0.3)
        assert state.counts == (50, 50, 50, 51, 51, 51, 52, 52)
        assert state.sum_s == pytest.approx(0.33)
        await asyncio.sleep(250)
        assert watch.state.worst_s == pytest.approx(0.0, abs=1e-9)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
