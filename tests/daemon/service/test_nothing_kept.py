"""Real instruments without a folder for what must survive a restart: it is said at the start and at every stop."""

import asyncio
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.rigs.real import build_pozsol
from daemon.service.operator import Operator
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.transports import InMemoryStream


def stopped(directory, *, simulated):
    """Run a tracker until a person has stopped it; return its alarms' names and the answer."""
    store = {} if directory is None else {"directory": directory}
    settings = Settings.model_validate({"bridge": {"listen": "127.0.0.1:0"}, "store": store})
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        loop = runner.get_loop()
        clock = LoopClock(loop.time, 1.7e9)
        line = InMemoryStream(PositionerCore(loop.time()), loop.time)
        instruments = TrackerInstruments(build_pozsol(settings, clock, line))
        rig = Rig(None, (instruments,), None, simulated=simulated)
        notifier = SystemdNotifier({}, 0)
        service = Service(settings, Role.TRACKER, rig, clock, Random(1), Bus(), bytes(range(32)), notifier)

        async def scenario():
            stop = asyncio.Event()
            serving = asyncio.create_task(service.run(stop))
            await asyncio.sleep(20)
            (tracker,) = service.trackers
            answer = await Operator(tracker, 1.0).stop("repair", "ana")
            names = {alarm.name for alarm in tracker.alarms.active}
            stop.set()
            await serving
            return names, answer.text

        return runner.run(scenario())


def test_a_missing_store_directory_is_an_alarm_from_the_start_and_named_in_the_answer_to_a_stop(caplog):
    alarms, answer = stopped(None, simulated=False)
    assert "nothing-kept" in alarms
    assert "; not kept: store.directory is not set: a restart forgets what persons asked for, " in answer
    assert sum("store.directory is not set" in message for message in caplog.messages) == 1


@pytest.mark.parametrize(("folder", "simulated"), [("records", False), (None, True)])
def test_the_nothing_kept_alarm_is_not_raised_with_a_store_directory_or_in_simulation(tmp_path, folder, simulated):
    alarms, answer = stopped(folder and tmp_path / folder, simulated=simulated)
    assert "nothing-kept" not in alarms
    assert "not kept" not in answer
    assert (tmp_path / "records" / "operator.json").is_file() is (folder is not None)
