"""Real instruments without anything that would stow them in a storm."""

import asyncio
from datetime import UTC, datetime
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.rigs.real import build_pozsol
from daemon.rigs.simulated import build_simulated_rig, build_weather
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from daemon.tracker.stow import WindStow
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.transports import InMemoryStream


def alarms_of(*, simulated=False, bench=False, sources=(), wind=None, role=Role.TRACKER, for_s=1.0, **safety):
    settings = Settings.model_validate(
        {"bridge": {"listen": "127.0.0.1:0"}, "safety": safety, "instruments": {"bench": bench}}
    )
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        loop = runner.get_loop()
        clock = LoopClock(loop.time, 1.7e9)
        line = InMemoryStream(PositionerCore(loop.time()), loop.time)
        positioner = build_pozsol(settings, clock, line)
        rig = Rig(None, (TrackerInstruments(positioner),), wind, simulated=simulated)
        service = Service(
            settings,
            role,
            rig,
            clock,
            Random(1),
            Bus(),
            bytes(range(32)),
            SystemdNotifier({}, 0),
            stow_sources={"tracker": sources},
        )

        async def briefly():
            stop = asyncio.Event()
            loop.call_later(for_s, stop.set)
            await service.run(stop)

        runner.run(briefly())
    return [alarm for tracker in service.trackers for alarm in tracker.alarms.active if alarm.name == "no-wind-source"]


def test_a_missing_wind_source_is_logged_once_and_shown_as_an_alarm(caplog):
    (alarm,) = alarms_of()
    assert alarm.text.startswith("no wind source: nothing stows the tracker in a storm")
    assert sum("no wind source" in record.message for record in caplog.records) == 1


def test_a_bench_in_the_settings_does_not_silence_the_no_wind_source_alarm():
    assert alarms_of(simulated=True, bench=True)


@pytest.mark.parametrize(
    "how",
    [
        {"simulated": True},
        {"wind": lambda: 3.0},
        {"sources": [WindStow(Settings().safety, lambda: 3.0)]},
        {"without_wind_source": "accepted"},
    ],
)
def test_no_alarm_of_a_missing_wind_source_in_simulation_with_a_source_or_when_accepted(how):
    assert not alarms_of(**how)


@pytest.mark.parametrize(("column", "values", "sensor"), [("", "", False), (",wind_speed", ",3.5", True)])
def test_a_simulated_rig_has_a_wind_sensor_only_if_its_measured_weather_has_wind(tmp_path, column, values, sensor):
    file = tmp_path / "weather.csv"
    minutes = [f"2022-10-12T{minute // 60:02d}:{minute % 60:02d}:00Z,500,600,80{values}" for minute in range(600, 720)]
    file.write_text("\n".join([f"time,ghi,dni,dhi{column}", *minutes, ""]))
    settings = Settings.model_validate({"simulation": {"weather": str(file)}})
    start_utc_s = datetime(2022, 10, 12, 10, 30, tzinfo=UTC).timestamp()
    weather, _ = build_weather(settings, start_utc_s, start_utc_s + 60)
    clock = LoopClock(lambda: 0.0, start_utc_s)
    rig = build_simulated_rig(settings, Role.TRACKER, clock, weather)
    assert (rig.wind_speed_m_s is not None) is sensor


def test_a_wind_source_beside_real_instruments_is_asked_every_second():
    asked = []

    def wind_m_s():
        asked.append(None)
        return 3.0

    alarms_of(sources=(WindStow(Settings().safety, wind_m_s),), for_s=60.0)
    assert len(asked) >= 60
