"""Three of many trackers are broken, each in its own way: the others decide, move and stop as if they were alone."""

import asyncio
import json

import pytest

from daemon.base.records import Decision, Mode, Move
from daemon.service.operator import CommandError
from daemon.service.operator_commands import Operators, parse
from solar.laws.sun_vector import SunVectorLaw

WELL = ("t0", "t4")
MANY = [
    {"name": "t0"},
    {"name": "law", "law": {"driver": "sun-vector"}},
    {"name": "hung"},
    {"name": "driver"},
    {"name": "t4"},
]
STOP_WITHIN_S = 1.0


class DefectError(Exception):
    pass


def modes(rig):
    return {tracker.name: tracker.control.mode for tracker in rig.service.trackers}


def alarms_of(rig, name):
    tracker = next(one for one in rig.service.trackers if one.name == name)
    return {alarm.name: alarm.text for alarm in tracker.alarms.active}


def test_a_raising_law_a_hung_driver_and_a_failing_driver_do_not_disturb_the_other_trackers(run_rig, monkeypatch):
    def fail(*_arguments):
        raise DefectError("out of range")

    async def never(*_arguments):
        await asyncio.Event().wait()

    async def scenario(rig):
        await rig.until(lambda: set(modes(rig).values()) == {Mode.TRACKING}, 120, "tracking of all")
        monkeypatch.setattr(SunVectorLaw, "direction", fail)
        _, hung, driver, _ = rig.others
        hung.read_telemetry = never
        driver.read_telemetry = fail
        begun_s, decided = rig.clock.monotonic(), len(rig.records_of(Decision))
        await asyncio.sleep(1800)
        assert modes(rig) == {
            "t0": Mode.TRACKING,
            "law": Mode.TRACKING,
            "hung": Mode.FAULT,
            "driver": Mode.FAULT,
            "t4": Mode.TRACKING,
        }
        later = rig.records_of(Decision)[decided:]
        for place, name in ((0, "t0"), (4, "t4")):
            own = [each.time_monotonic_s for each in later if each.tracker == name]
            assert len(own) >= 5
            assert all(time_s % 300.0 == pytest.approx(60.0 * place, abs=0.1) for time_s in own[1:])
            assert any(move.tracker == name and move.time_monotonic_s > begun_s for move in rig.records_of(Move))
            assert alarms_of(rig, name) == {}
        assert "the law sun-vector has failed (DefectError: out of range)" in alarms_of(rig, "law")["law-failed"]
        assert {each.law for each in later if each.tracker == "law"} == {"chronometric"}
        assert "a call of its driver has not returned for" in alarms_of(rig, "hung")["driver-hung"]
        assert (
            "DefectError: out of range: the tracker driver is neither moved nor stowed"
            in alarms_of(rig, "driver")["driver-hung"]
        )

        sent = {}
        for name, core in zip(("law", "hung", "driver", "t4"), rig.cables.others, strict=True):
            sent[name] = core.sent = []
            send = core.send

            async def noted(packet, send=send, own=sent[name]):
                own.append(rig.clock.monotonic())
                await send(packet)

            core.send = noted
        asked_s = rig.clock.monotonic()
        with pytest.raises(CommandError, match=r"^NOT done by 2 of 5 trackers, hung, driver:\n") as refused:
            await Operators(rig.service.trackers, 1.0).carry_out(
                parse("stop", json.dumps({"why": "fire"}).encode(), "test")
            )
        assert all(sent[name][0] - asked_s <= STOP_WITHIN_S for name in ("law", "t4")), sent
        first = str(refused.value).splitlines()[1:3]
        assert [line.split()[:5] for line in first] == [
            [f"{name}:", "stop", "could", "not", "be"] for name in ("hung", "driver")
        ]
        assert {modes(rig)[name] for name in (*WELL, "law")} == {Mode.HOLD}

    run_rig(scenario, tracker=MANY, law={"driver": "mu-prime"}, rest_look_s=5.0)
