"""A person's stop, maintenance and the unit's buttons: nothing moves until `auto`, whatever is asked for."""

import asyncio
import re
from dataclasses import replace

import pytest

from daemon.base.records import Event, Mode, Move
from daemon.base.state import StateFolder
from daemon.service.operator import CommandError, Operator
from daemon.tracker.wishes import Wishes, WishFile
from drivers.errors import DeviceError, RefusedError
from tests.daemon.tracker.days import pass_quietly
from tests.support import DOCS
from tests.support.motion import commands_sent
from tests.support.phases import wait_for_move, wait_for_rest, wait_for_tracking

OTHERS = ("stow", "snow", "hold", "goto", "home", "clear", "relearn", "maintenance")


def operator(rig):
    return Operator(rig.tracker, 1.0)


async def call(rig, name, why="x"):
    place = (10.0, 60.0) if name == "goto" else ()
    return await getattr(operator(rig), name)(*place, why, "eve")


def alarms(rig):
    return {alarm.name: alarm.text for alarm in rig.tracker.alarms.active}


def reminders(rig):
    return [event for event in rig.records_of(Event) if event.text.startswith("still in maintenance by ana@lab")]


def press_a_button(rig):
    """Press a button at the unit; return a function that lets it go."""
    read, pressed = rig.positioner.read_telemetry, [True]

    async def with_button():
        seen = await read()
        return replace(seen, button_pressed=pressed[0], status_monotonic_s=rig.clock.monotonic())

    rig.positioner.read_telemetry = with_button
    return lambda: pressed.__setitem__(0, False)


@pytest.mark.parametrize("name", OTHERS)
def test_under_a_stop_every_command_is_refused_with_who_when_why_and_how_it_ends(run_rig, name):
    async def scenario(rig):
        await wait_for_move(rig)
        await operator(rig).stop("a hand near the actuator", "ana@lab")
        stands, before = rig.truth(), len(rig.records_of(Move))
        with pytest.raises(CommandError) as refused:
            await call(rig, name)
        assert not refused.value.wrong
        assert str(refused.value).startswith(f"no {name}: the tracker is stopped by ana@lab since 2022-10-12 10:0")
        assert str(refused.value).endswith(" UTC: a hand near the actuator; only 'heliocube auto' releases it")
        # Two decisions of the law would have been due.
        await asyncio.sleep(700)
        assert rig.truth() == stands
        assert len(rig.records_of(Move)) == before
        assert rig.control.wishes.stow is rig.control.wishes.hold is rig.control.wishes.snow is None
        answer = await call(rig, "auto")
        assert "; released: stopped by ana@lab since " in answer.text
        await rig.until_mode(Mode.TRACKING, 30)

    run_rig(scenario, cube={"scan_every_s": 20}, safety={"scan_stale_s": 65})


def test_under_a_stop_commands_given_directly_to_control_or_motion_are_refused_too(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await rig.control.stop("repair")
        control = rig.control
        for ask in (
            lambda: control.stow("x"),
            lambda: control.snow("x"),
            lambda: control.hold("x"),
            lambda: control.goto(0, 60, "x"),
            control.home,
            control.clear_faults,
            rig.motion.home,
        ):
            with pytest.raises(RefusedError, match=r"stopped since .*: repair; only 'heliocube auto' releases it"):
                ask()

    run_rig(scenario)


def test_a_power_cycled_unit_makes_no_reference_run_under_a_stop_and_makes_one_after_auto(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).stop("supply off and on", "ana")
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await rig.until_mode(Mode.HOLD, 15)
        stands = rig.truth()
        await asyncio.sleep(1800)
        assert rig.truth() == stands
        await operator(rig).auto("done")
        await rig.until(lambda: rig.motion.homing, 30, "homing")

    run_rig(scenario, motion={"rehome": "automatic"})


def test_a_second_stop_is_sent_and_noted_beside_the_first_until_both_are_released(run_rig, monkeypatch, tmp_path):
    whose = r"stopped by ana since \S+ \S+ UTC: repair; also by bob since \S+ \S+ UTC: a noise"

    async def first(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).stop("repair", "ana")
        sent = commands_sent(rig, monkeypatch)
        desk = operator(rig)
        answer = await desk.stop("a noise", "bob")
        assert sent[0][1].startswith(b"$9s")
        assert answer.done
        assert re.search(rf"mode hold: {whose}$", answer.text)
        # So soon after another stop that the packet is not sent again.
        both = await asyncio.gather(desk.stop("a noise", "bob"), desk.stop("me too", "eve"))
        assert [each.done for each in both] == [True, True]
        told = [event.text for event in rig.records_of(Event) if event.subject == "operator"]
        assert told == ["stop: repair (ana)", *["stop: a noise (bob)"] * 2, "stop: me too (eve)"]

    async def second(rig):
        await rig.until_mode(Mode.HOLD, 15)
        assert re.fullmatch(rf"{whose}; also by eve since \S+ \S+ UTC: me too", rig.control.why)
        with pytest.raises(CommandError, match=whose):
            await call(rig, "goto")
        answer = await call(rig, "auto")
        assert re.search(rf"; released: {whose}", answer.text)
        assert rig.control.wishes == Wishes()

    for scenario in (first, second):
        run_rig(scenario, store={"directory": tmp_path})


def test_strong_wind_in_maintenance_raises_no_alarm_as_the_page_on_security_says(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).maintenance("repair", "ana")
        rig.wind_m_s = 20.0
        await asyncio.sleep(60)
        assert not alarms(rig)
        assert "stow is wanted and not done (wind 20.0 m/s" in rig.control.why

    run_rig(scenario)
    page = " ".join((DOCS / "security.md").read_text().split())
    assert "Of these a stop raises an alarm then; maintenance raises none" in page


def test_strong_wind_under_a_stop_raises_an_alarm_that_ends_with_the_stop(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).stop("repair", "ana")
        stands = rig.truth()
        rig.wind_m_s = 20.0
        await rig.until(lambda: "stow-wanted" in alarms(rig), 6, "the alarm")
        text = alarms(rig)["stow-wanted"]
        assert text.startswith(
            "stow is wanted (wind 20.0 m/s, stow from 15 m/s), but the tracker is stopped by ana since"
        )
        assert text.endswith("; only 'heliocube auto' releases it")
        await asyncio.sleep(600)
        assert rig.truth() == stands
        await operator(rig).auto("clear of the axes")
        assert rig.mode is Mode.STOW
        assert not alarms(rig)
        told = [event.text for event in rig.records_of(Event) if event.subject == "alarm"]
        assert len(told) == 2

    run_rig(scenario)


def test_a_stop_survives_a_restart_with_the_person_the_time_and_the_reason(run_rig, tmp_path):
    async def first(rig):
        await wait_for_tracking(rig)
        await operator(rig).stop("repair", "ana@lab")

    async def second(rig):
        await asyncio.sleep(60)
        assert rig.mode is Mode.HOLD
        assert re.fullmatch(r"stopped by ana@lab since 2022-10-12 10:0\d:\d\d UTC: repair", rig.control.why)
        with pytest.raises(CommandError, match=f"no goto: the tracker is {rig.control.why}; only"):
            await call(rig, "goto")

    for scenario, start in ((first, "10:00"), (second, "13:00")):
        run_rig(scenario, start=f"2022-10-12T{start}", store={"directory": tmp_path})


def test_a_stop_and_a_hold_in_a_file_of_an_earlier_version_are_in_force(run_rig, tmp_path):
    (tmp_path / "operator.json").write_text('{"stop": "repair", "stow": null, "hold": "test"}')

    async def scenario(rig):
        await asyncio.sleep(300)
        assert (rig.mode, rig.control.why) == (Mode.HOLD, "stopped: repair")
        assert rig.control.wishes.hold.why == "test"
        assert not rig.records_of(Move)

    run_rig(scenario, store={"directory": tmp_path})


def test_a_stop_that_cannot_be_sent_is_kept_and_in_force_after_a_restart(run_rig, tmp_path):
    async def first(rig):
        await wait_for_move(rig)
        rig.cables.positioner.link_up = False
        with pytest.raises(DeviceError):
            await rig.control.stop("a hand", "ana")

    async def second(rig):
        await asyncio.sleep(900)
        assert rig.mode is Mode.HOLD
        assert re.fullmatch(r"stopped by ana since \S+ 10:0\d:\d\d UTC: a hand", rig.control.why)
        assert not rig.records_of(Move)

    for scenario, start in ((first, "10:00"), (second, "13:00")):
        run_rig(scenario, start=f"2022-10-12T{start}", store={"directory": tmp_path})


def test_a_stop_of_an_unplugged_positioner_is_named_beside_the_fault_and_in_force_when_it_returns(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.cables.positioner.link_up = False
        await rig.until_mode(Mode.FAULT, 15)
        with pytest.raises(CommandError, match="stop could not be sent"):
            await operator(rig).stop("repair", "ana")
        with pytest.raises(CommandError, match=r"unplugged; also in force: stopped by ana since \S+ \S+ UTC: repair$"):
            await operator(rig).stop("a noise", "bob")
        assert rig.mode is Mode.FAULT
        assert "unplugged; stopped by ana since " in rig.control.why
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.HOLD, 60)
        await asyncio.sleep(5)
        stands = rig.truth()
        await asyncio.sleep(900)
        assert rig.truth() == stands

    run_rig(scenario)


def test_a_stop_that_the_unit_does_not_receive_is_not_reported_as_done(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        feed = rig.unit.feed
        monkeypatch.setattr(rig.unit, "feed", lambda data, now: None if data.startswith(b"$9s") else feed(data, now))
        answer = await operator(rig).stop("a hand")
        assert (answer.done, answer.seen) == (False, "not-seen")

    run_rig(scenario, start="2022-10-12T10:00")


def test_a_hold_is_done_only_when_telemetry_from_after_it_shows_standstill(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await asyncio.sleep(11)
        assert (await operator(rig).hold("test")).done
        rig.positioner.read_telemetry = lambda: asyncio.sleep(3600)
        asked_s = rig.clock.monotonic()
        assert (await operator(rig).hold("test")).seen == "not-seen"
        assert rig.clock.monotonic() - asked_s == pytest.approx(3.0, abs=0.1)
        asked_s = rig.clock.monotonic()
        await Operator(rig.tracker, 10.0).hold("test")
        assert rig.clock.monotonic() - asked_s == pytest.approx(30.0, abs=1.0)

    run_rig(scenario)


# A person at the unit


def test_a_button_pressed_at_the_unit_holds_the_tracker_until_a_person_gives_auto(run_rig, tmp_path):
    async def scenario(rig):
        await wait_for_move(rig)
        let_go = press_a_button(rig)
        await rig.until_mode(Mode.HOLD, 2)
        assert "a button was pressed at the unit: a person is there" in rig.control.why
        assert WishFile(StateFolder(tmp_path)).load().buttons is not None, "a restart does not forget it"
        await wait_for_rest(rig)
        stands = rig.truth()
        let_go()
        with pytest.raises(CommandError, match=r"no goto: the tracker is held since .*a person is there; only"):
            await call(rig, "goto")
        await asyncio.sleep(1800)
        assert rig.truth() == stands
        answer = await call(rig, "auto")
        assert "released: held since" in answer.text
        await rig.until_mode(Mode.TRACKING, 30)
        await asyncio.sleep(60)
        assert rig.mode is Mode.TRACKING

    run_rig(scenario, store={"directory": tmp_path})


def test_auto_while_the_button_is_still_pressed_holds_again(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        press_a_button(rig)
        await rig.until_mode(Mode.HOLD, 11)
        stands = rig.truth()
        await call(rig, "auto")
        await asyncio.sleep(11)
        assert rig.mode is Mode.HOLD
        await call(rig, "maintenance")
        assert rig.mode is Mode.MAINTENANCE
        assert rig.truth() == pytest.approx(stands, abs=0.3)

    run_rig(scenario)


def test_a_button_press_that_was_seen_before_auto_does_not_hold_the_tracker_again(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        read, pressed_s = rig.positioner.read_telemetry, rig.clock.monotonic()

        async def with_an_old_screen():
            return replace(await read(), button_pressed=True, status_monotonic_s=pressed_s)

        rig.positioner.read_telemetry = with_an_old_screen
        await rig.until_mode(Mode.HOLD, 11)
        await call(rig, "auto")
        await asyncio.sleep(11)
        assert rig.mode is Mode.TRACKING

    run_rig(scenario)


# Maintenance


def test_in_maintenance_nothing_moves_no_alarm_sounds_and_a_reminder_comes_after_a_day(run_rig, tmp_path):
    async def first(rig):
        await wait_for_move(rig)
        answer = await operator(rig).maintenance("greasing", "ana@lab")
        assert answer.done
        assert rig.mode is Mode.MAINTENANCE
        for name in OTHERS:
            with pytest.raises(CommandError, match=f"no {name}: the tracker is in maintenance by ana@lab since"):
                await call(rig, name)
        stands = rig.truth()
        rig.wind_m_s = 20.0
        await asyncio.sleep(1800)
        pass_quietly(rig, "2022-10-13T09:50")
        await asyncio.sleep(300)
        assert not reminders(rig)
        await asyncio.sleep(900)
        assert rig.truth() == stands
        assert not alarms(rig)
        assert "stow is wanted and not done (wind" in rig.control.why
        assert len(reminders(rig)) == 1

    async def second(rig):
        await asyncio.sleep(600)
        assert rig.mode is Mode.MAINTENANCE
        assert (await operator(rig).stop("wait", "bob")).done
        assert rig.mode is Mode.MAINTENANCE
        await operator(rig).auto("done")
        assert rig.mode not in (Mode.MAINTENANCE, Mode.HOLD)

    slow = {"store": {"directory": tmp_path}, "cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130}}
    for scenario in (first, second):
        run_rig(scenario, **slow)


def test_maintenance_of_an_unplugged_positioner_is_in_force_and_its_reason_names_both(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.cables.positioner.link_up = False
        await rig.until_mode(Mode.FAULT, 15)
        with pytest.raises(CommandError, match="maintenance is noted, but stop could not be sent"):
            await operator(rig).maintenance("cable", "ana")
        assert rig.mode is Mode.MAINTENANCE
        assert "cable; positioner: is unplugged" in rig.control.why

    run_rig(scenario)
