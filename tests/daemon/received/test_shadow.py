"""A law in the shadow of the one that points: what it would have gained, and that it moves nothing."""

import asyncio
import json
from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Decision, Event, Mode, Move
from daemon.commands.file_check import check_file
from daemon.service.operator import Operator
from daemon.service.recent import RecentRecords
from daemon.service.state import state_json
from solar.laws.chronometric import ChronometricLaw
from tests.support.rig import ManualWeather

SELDOM = {
    "cube": {"scan_every_s": 30},
    "windows": {"mean_s": 60},
    "safety": {"scan_stale_s": 65, "fallback_after_s": 600},
    "rest_look_s": 30.0,
}
OVERCAST = ManualWeather(dni=0, dhi=150)


class Flickering(ManualWeather):
    def at(self, utc_s):
        return replace(super().at(utc_s), dni_w_m2=self.dni * (utc_s // 600 % 2))


def seen(rig):
    return state_json(rig.take_snapshot(RecentRecords()))["shadow"]


def told(rig):
    return [event.text for event in rig.records_of(Event) if event.subject == "shadow"]


async def until_known(rig, seconds):
    def known():
        received = seen(rig)["received"]
        return received is not None and received["known_s"] >= seconds

    await rig.until(known, 4000, f"{seconds} s of light", every_s=10.0)


async def most_of_an_hour(rig):
    await rig.until_mode(Mode.TRACKING, 120)
    await rig.until(
        lambda: seen(rig)["received"] and seen(rig)["received"]["known_s"] >= 3000, 4000, "most of an hour", 10.0
    )


def test_under_an_overcast_sky_a_flat_shadow_law_gains_over_chronometric_and_moves_nothing(run_rig):
    async def scenario(rig):
        await most_of_an_hour(rig)
        own, shadow = state_json(rig.take_snapshot(RecentRecords()))["received"], seen(rig)
        # Both are in the same light, and the law in the shadow is the best one here.
        assert shadow["received"]["actual_kwh_m2"] == pytest.approx(own["best_kwh_m2"], rel=0.02)
        assert shadow["gain"] == pytest.approx(own["best_kwh_m2"] / own["actual_kwh_m2"] - 1.0, abs=0.02)
        assert shadow["gain"] > 0.05
        assert shadow["law"] == "flat"
        # The law in the shadow has stayed flat from the start.
        assert shadow["moves"] == 0
        assert shadow["active_moves"] >= 5

    rig = run_rig(scenario, law={"driver": "chronometric", "shadow": "flat"}, weather=OVERCAST, **SELDOM)
    assert {decision.law for decision in rig.records_of(Decision)} == {"chronometric"}
    assert rig.truth().b_deg < 60.0


def test_a_shadow_law_that_agrees_with_the_active_law_shows_no_gain(run_rig):
    async def scenario(rig):
        await most_of_an_hour(rig)
        shadow = seen(rig)
        assert abs(shadow["gain"]) < 0.002
        assert shadow["travelled_deg"] == pytest.approx(shadow["active_travelled_deg"], abs=8.0)

    run_rig(scenario, law={"driver": "chronometric", "shadow": "sun-vector"})


def test_the_moves_per_day_of_the_shadow_law_are_also_spread_until_sunset(run_rig):
    async def scenario(rig):
        await most_of_an_hour(rig)
        # At ten o'clock half of the six moves are due, and the fourth at 10:55.
        assert seen(rig)["moves"] == 3

    law, motion = {"driver": "mu-prime", "shadow": "chronometric"}, {"moves_per_day": 6}
    run_rig(scenario, law=law, motion=motion, **SELDOM)


def test_while_a_person_holds_the_tracker_the_shadow_law_does_not_move_and_gains_nothing(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await asyncio.sleep(60)
        await Operator(rig.tracker, 1.0).hold("looking", "ana")
        await rig.until_mode(Mode.HOLD, 60)
        before = seen(rig)
        await asyncio.sleep(1800)
        assert seen(rig)["moves"] == before["moves"]
        assert seen(rig)["gain"] == pytest.approx(0.0, abs=0.01)

    run_rig(scenario, law={"driver": "chronometric", "shadow": "flat"}, weather=OVERCAST)


def test_a_night_event_reports_what_the_shadow_law_would_have_received_that_day(run_rig):
    async def scenario(rig):
        await until_known(rig, 900)
        await rig.until(lambda: told(rig), 12 * 3600, "solar midnight", every_s=60.0)

    law = {"driver": "chronometric", "shadow": "flat"}
    rig = run_rig(scenario, law=law, weather=OVERCAST, start="2022-10-12T16:00", **SELDOM)
    (text,) = told(rig)
    assert text.startswith("on 2022-10-12 flat in the shadow would have received 0.")
    assert " where chronometric received 0." in text
    assert text.endswith(" h of readings")


def test_moves_without_the_cube_after_midnight_count_for_the_new_day_and_for_both_laws(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await asyncio.sleep(2400)
        before = rig.control.budget.used
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(2 * 3600)
        asyncio.get_running_loop().skip(12 * 3600)
        await asyncio.sleep(2.5 * 3600)
        used = rig.control.budget.used
        # As many moves as on the day before, but less far: following the sun by the clock takes short ones.
        assert used.day == before.day + 1
        assert used.moves >= before.moves
        assert used.travelled_deg < before.travelled_deg
        rig.cables.voltmeter.link_up = True
        await rig.until_mode(Mode.TRACKING, 120)
        assert told(rig)[0].startswith("on 2022-10-12 chronometric in the shadow would have received 0.")
        shadow = seen(rig)
        assert shadow["failed_why"] is None
        assert shadow["active_moves"] == used.moves
        assert shadow["active_travelled_deg"] == pytest.approx(used.travelled_deg)
        # The law in the shadow would have followed the sun by the clock as well.
        assert shadow["moves"] == used.moves
        assert shadow["travelled_deg"] == pytest.approx(used.travelled_deg)

    law = {"driver": "mu-prime", "shadow": "chronometric"}
    run_rig(scenario, law=law, weather=Flickering(), start="2022-10-12T15:00", **SELDOM)


def test_a_shadow_law_that_raises_is_reported_once_and_the_tracker_goes_on(run_rig, monkeypatch):
    def fails(*_):
        raise RuntimeError("no such sky")

    monkeypatch.setattr(ChronometricLaw, "aim", fails)

    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.until(lambda: told(rig), 600, "the failure")
        moves = len(rig.records_of(Decision))
        await rig.until(lambda: len(rig.records_of(Decision)) > moves + 1, 900, "two more decisions")
        assert seen(rig)["failed_why"] == "RuntimeError: no such sky"

    rig = run_rig(scenario, law={"driver": "mu-prime", "shadow": "chronometric"})
    assert len(told(rig)) == 1
    assert rig.mode is Mode.TRACKING
    assert rig.records_of(Move)


@pytest.mark.parametrize("name", ["learned", "relearn", "to_dict"])
def test_a_shadow_law_that_raises_while_learning_or_being_saved_does_not_stop_tracking(run_rig, monkeypatch, name):
    def fails(*_):
        raise RuntimeError("no such sky")

    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        monkeypatch.setattr(ChronometricLaw, name, property(fails) if name == "learned" else fails, raising=False)
        if name != "learned":
            rig.tracker.shadow.relearn()
        await rig.until(lambda: told(rig), 900, "what is told of it")
        assert seen(rig)["failed_why"] == "RuntimeError: no such sky"
        assert rig.mode is Mode.TRACKING

    rig = run_rig(scenario, law={"driver": "mu-prime", "shadow": "chronometric"})
    assert len(told(rig)) == 1


def test_what_the_shadow_law_has_learned_moved_and_received_outlives_a_restart(run_rig, tmp_path):
    def kept(name):
        return json.loads((tmp_path / f"shadow-optimal-{name}.json").read_text())

    async def before(rig):
        await most_of_an_hour(rig)
        # The law learns from a day when it is over.
        asyncio.get_running_loop().skip(23 * 3600)
        await rig.until(lambda: told(rig), 300, "what the day was worth")
        await most_of_an_hour(rig)

    async def again(rig):
        await asyncio.sleep(5)
        assert rig.tracker.shadow.albedo == learned["albedo"]
        assert (seen(rig)["moves"], seen(rig)["active_moves"]) == (day["moves"], day["active_moves"])
        assert seen(rig)["received"]["known_s"] == pytest.approx(received["known_s"], abs=60.0)

    law = {"driver": "chronometric", "shadow": "optimal", "albedo": 0.35}
    given = {"store": {"directory": tmp_path}, "law": law, **SELDOM}
    run_rig(before, start="2022-10-12T10:00", **given)
    learned, day, received = kept("learned"), kept("day"), kept("received")
    assert abs(learned["albedo"] - 0.35) > 0.01, "it has learned something"
    assert min(day["moves"], day["active_moves"]) >= 5
    assert received["known_s"] > 1800.0
    run_rig(again, start="2022-10-13T11:00", **given)


def test_a_start_with_a_clock_years_behind_forgets_nothing_of_the_day_it_is_later_set_to(run_rig, tmp_path):
    files = ("received.json", "shadow-chronometric-received.json", "shadow-chronometric-day.json")

    def kept():
        return [json.loads((tmp_path / name).read_text()) for name in files]

    async def before(rig):
        await most_of_an_hour(rig)

    async def again(rig):
        await asyncio.sleep(1800)
        assert 900 < seen(rig)["received"]["known_s"] < shadow["known_s"]
        assert kept() == [own, shadow, day]
        rig.synchronised = True
        rig.clock.step_s = 3 * 365 * 86400.0
        await asyncio.sleep(900)
        assert 0 <= state_json(rig.take_snapshot(RecentRecords()))["received"]["known_s"] - own["known_s"] <= 1200
        assert 0 <= seen(rig)["received"]["known_s"] - shadow["known_s"] <= 1200
        assert seen(rig)["active_moves"] >= day["active_moves"] > 0

    law = {"driver": "mu-prime", "shadow": "chronometric"}
    given = {"store": {"directory": tmp_path}, "law": law, "weather": Flickering(), **SELDOM}
    run_rig(before, start="2022-10-12T10:00", **given)
    own, shadow, day = kept()
    run_rig(again, start="2019-10-13T11:30", **given)


@pytest.mark.parametrize("name", ["mu-prime", "nought"])
def test_a_shadow_law_that_is_not_installed_or_is_the_active_law_is_refused(tmp_path, name):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[law]\nshadow = '{name}'\n")
    with pytest.raises(UserError) as refused:
        check_file(file)
    expected = (
        f'law.shadow = "{name}": is not a law that can run beside mu-prime; those are chronometric, flat, optimal, sun-'
    )
    assert expected in str(refused.value)
