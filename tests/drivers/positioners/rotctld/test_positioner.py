"""The driver of rotators on a simulated rotctld, in virtual time: what is sent, and what is believed."""

import asyncio

import pytest

from drivers.errors import (
    ConnectError,
    IdentityError,
    LinkLostError,
    ProtocolError,
    RefusedError,
    StillMovingError,
)
from tests.drivers.positioners.rotctld.told import (
    STATE,
    Told,
    at,
    driver_on,
    ends_with,
    on_rotator,
    opened,
    run,
    told,
)


def test_a_rotator_is_identified_by_its_rotctld_and_opening_sends_nothing_that_moves_it():
    identity, line = opened()
    assert (identity.board, identity.firmware, identity.serial) == ("SPID", "Hamlib model 603", "")
    assert (identity.simulated, identity.setup_conflicts) == (False, ())
    assert line.sent == ["get_info", "dump_state", "get_pos"]
    assert opened(get_info=ends_with("get_info", 0))[0].board == "rotator"
    assert opened(dump_state=STATE.replace(b"603", b"1"))[0].simulated


@pytest.mark.parametrize(("says", "error", "sentence"), [
    ({"dump_state": ends_with("dump_state", -8)}, ConnectError, r"dump_state with protocol error of the rotator"),
    ({"dump_state": STATE.replace(b"603", b"?")}, ConnectError, "dump_state cannot be read"),
    ({"get_pos": at("nan", 0)}, ConnectError, "reports no position that can be read"),
    ({"get_pos": ends_with("get_pos", -6)}, ConnectError, "get_pos with no connection to the rotator"),
    ({"get_info": at(0, 0)}, ConnectError, "answers get_pos to get_info: is it rotctld"),
    ({"get_info": b"RPRT 0\n"}, ConnectError, "answers without a name to get_info"),
])  # fmt: skip
def test_a_rotctld_whose_answers_cannot_be_read_is_not_opened_and_its_line_is_closed(says, error, sentence):
    line = Told(**says)
    with pytest.raises(error, match=sentence):
        run(lambda now: driver_on(line, now).open())
    assert not line.is_open


def test_only_a_rotator_of_the_configured_hamlib_model_is_opened():
    line = Told()
    with pytest.raises(IdentityError, match=r"model 603, but instruments\.positioner\.model is 604"):
        run(lambda now: driver_on(line, now, model=604).open())
    assert not line.is_open
    assert run(lambda now: driver_on(line, now, model=603).open()).firmware == "Hamlib model 603"


@pytest.mark.parametrize(("place", "believed"), [
    ((720, 45), True), ((-720, 45), True), ((720.1, 45), False), ((-720.1, 45), False),
    ((180, -90), True), ((180, 180), True), ((180, -90.1), False), ((180, 180.1), False),
])  # fmt: skip
def test_a_reported_position_where_no_rotator_can_point_is_a_protocol_error(place, believed):
    async def look(driver, line):
        line.says["get_pos"] = at(*place)
        if believed:
            assert (await driver.read_telemetry()).position_b == place[1]
        else:
            with pytest.raises(ProtocolError, match=f"reports azimuth {place[0]:g}, elevation {place[1]:g} deg"):
                await driver.read_telemetry()

    told(look)


@pytest.mark.parametrize(("a_deg", "b_deg", "goes"), [
    (-50.0, 45.0, True), (50.0, 45.0, True), (0.0, 15.0, True), (0.0, 90.0, True),
    (-50.1, 45.0, False), (50.1, 45.0, False), (0.0, 14.9, False), (0.0, 90.1, False),
    (float("nan"), 45.0, False), (0.0, float("nan"), False), (float("inf"), 45.0, False), (0.0, float("inf"), False),
])  # fmt: skip
def test_a_target_within_the_limits_is_sent_and_one_beyond_them_is_refused_and_not_sent(a_deg, b_deg, goes):
    async def move(driver, _):
        if goes:
            await driver.move_to(a_deg, b_deg)
        else:
            with pytest.raises(ValueError, match=r"outside the limits \(A -50 to 50, B 15 to 90 deg\)"):
                await driver.move_to(a_deg, b_deg)

    _, line = told(move)
    assert [sent.partition(" ")[0] for sent in line.sent] == (["get_pos", "set_pos"] if goes else [])


def test_telemetry_shows_the_target_until_a_stop_or_a_refusal_removes_it():
    async def move(driver, line):
        async def aims_at():
            seen = await driver.read_telemetry()
            return seen.destination_a, seen.destination_b

        assert await aims_at() == (180.0, 45.0)
        await driver.move_to(0.0, 60.0)
        assert await aims_at() == pytest.approx((180.0, 60.0))
        await driver.stop()
        assert await aims_at() == (180.0, 45.0)
        line.says["set_pos"] = ends_with("set_pos", -1)
        sentence = r"did not take azimuth 180\.00, elevation 60\.00 deg: invalid parameter \(RPRT -1\)"
        with pytest.raises(RefusedError, match=sentence):
            await driver.move_to(0.0, 60.0)
        assert await aims_at() == (180.0, 45.0)

    told(move)


def test_a_target_beyond_the_range_of_the_rotator_is_refused_with_that_range_and_not_sent():
    sentence = (
        "is not given the target A 0.0, B 75.0 deg: it lies at azimuth 180.0, elevation 75.0 deg,"
        " but the rotator turns azimuth 0 to 360 and elevation 0 to 60 deg"
    )

    async def move(driver, line):
        with pytest.raises(RefusedError) as caught:
            await driver.move_to(0.0, 75.0)
        assert caught.value.message == sentence
        assert line.sent == ["get_pos"]

    told(move, (0.0, 50.0), {"elevation_max_deg": 60.0})


def test_a_stop_that_comes_while_a_move_is_prepared_keeps_its_target_from_being_sent():
    class Slow(Told):
        async def ask(self, command, within_s):
            await asyncio.sleep(0.1)
            return await super().ask(command, within_s)

    line = Slow()

    async def scenario(now):
        driver = driver_on(line, now)
        await driver.open()
        move = asyncio.ensure_future(driver.move_to(0.0, 60.0))
        await asyncio.sleep(0.05)
        await driver.stop()
        with pytest.raises(RefusedError, match="a stop came in between"):
            await move

    run(scenario)
    assert "set_pos 180.00 60.00" not in line.sent


def test_a_stop_that_does_not_reach_the_rotator_is_reported_with_the_remedy():
    sentence = r"rotctld answers stop with time-out of the rotator \(RPRT -5\): .* then restart rotctld"
    with pytest.raises(LinkLostError, match=sentence):
        told(lambda driver, _: driver.stop(), stop=ends_with("stop", -5))


@pytest.mark.parametrize("error", [-5, -6, -8])
def test_a_present_position_sent_in_place_of_a_stop_that_does_not_arrive_is_a_lost_link(error):
    with pytest.raises(LinkLostError, match=rf"rotctld answers set_pos with .* \(RPRT {error}\): look at the rotator"):
        told(lambda driver, _: driver.stop(), stop=ends_with("stop", -11), set_pos=ends_with("set_pos", error))


@pytest.mark.parametrize("error", [-1, -9, -21])
def test_a_present_position_refused_in_place_of_a_stop_raises_nothing_and_leaves_the_line_open(error):
    _, line = told(lambda driver, _: driver.stop(), stop=ends_with("stop", -4), set_pos=ends_with("set_pos", error))
    assert line.is_open


def test_a_target_that_does_not_reach_the_rotator_is_refused_without_blaming_its_limits():
    with pytest.raises(RefusedError) as caught:
        told(lambda driver, _: driver.move_to(0.0, 60.0), set_pos=ends_with("set_pos", -6))
    assert caught.value.message.endswith("elevation 60.00 deg: no connection to the rotator (RPRT -6)")


def test_the_range_of_the_rotator_is_unknown_before_the_driver_is_first_opened():
    async def scenario(now):
        driver = driver_on(Told(), now)
        assert driver.mount is None
        with pytest.raises(LinkLostError, match="has to be opened first"):
            await driver.read_telemetry()
        await driver.open()
        await driver.open()
        assert (driver.mount.azimuth_min_deg, driver.mount.azimuth_max_deg) == (0.0, 360.0)

    run(scenario)


def test_telemetry_shows_where_the_rotator_points_with_the_time_at_which_it_was_asked_for():
    class Slow(Told):
        async def ask(self, command, within_s):
            reply = await super().ask(command, within_s)
            await asyncio.sleep(0.5)
            return reply

    async def scenario(now):
        line = Slow()
        driver = driver_on(line, now)
        await driver.open()
        for azimuth_deg, a_deg in ((180.0, 0.0), (270.0, 45.0)):
            line.says["get_pos"] = at(azimuth_deg, 45.0)
            asked_s = now()
            seen = await driver.read_telemetry()
            assert now() == pytest.approx(asked_s + 0.5)
            assert seen.time_monotonic_s == seen.status_monotonic_s == asked_s
            assert seen.a_deg == pytest.approx(a_deg)
            assert seen.details == {"azimuth_deg": azimuth_deg, "elevation_deg": 45.0}

    run(scenario)


def test_halt_returns_quickly_for_a_standing_rotator_and_waits_until_a_turning_one_stands():
    async def scenario(driver, rotator, now):
        begin_s = now()
        await driver.halt()
        assert 0.6 <= now() - begin_s < 0.9
        assert rotator.received["stop"] == 1
        await driver.move_to(-30.0, 45.0)
        await asyncio.sleep(2.0)
        await driver.halt()
        stands = rotator.position(now())
        await asyncio.sleep(30.0)
        assert rotator.position(now()) == stands

    # At these settings, 0.6 s is the shortest time that counts as standing.
    on_rotator(scenario, slowest_deg_per_s=1.0)


@pytest.mark.parametrize(("resolution_deg", "slowest_deg_per_s", "stands_for_s"), [
    (0.1, 1.0, 0.6), (0.5, 0.5, 1.8), (0.001, 0.02, 2.625),
])  # fmt: skip
def test_halt_watches_a_slow_or_coarsely_rounded_rotator_for_longer(resolution_deg, slowest_deg_per_s, stands_for_s):
    async def scenario(driver, _, now):
        begin_s = now()
        await driver.halt()
        assert stands_for_s - 1e-6 <= now() - begin_s <= stands_for_s + 0.16

    on_rotator(scenario, resolution_deg=resolution_deg, slowest_deg_per_s=slowest_deg_per_s)


@pytest.mark.parametrize(
    ("way_deg", "stands"), [((0.11, 0), True), ((0, 0.11), True), ((0.13, 0), False), ((0, -0.13), False)]
)
def test_a_rotator_counts_as_moving_if_its_position_changes_by_more_than_its_resolution(way_deg, stands):
    class Trembling(Told):
        async def ask(self, command, within_s):
            there = self.sent.count("get_pos") % 2
            self.says["get_pos"] = at(180 + there * way_deg[0], 45 + there * way_deg[1])
            return await super().ask(command, within_s)

    line = Trembling()

    async def scenario(now):
        driver = driver_on(line, now, slowest_deg_per_s=1.0)
        await driver.open()
        begin_s = now()
        if stands:
            await driver.halt()
            assert now() - begin_s == pytest.approx(0.6)
            return
        with pytest.raises(StillMovingError, match=r"keeps moving after 13 s of stops, at azimuth 180\.\d, elev"):
            await driver.halt()
        # The error comes at the first look after 12 s and the 0.6 s that count as standing.
        assert 12.6 <= now() - begin_s <= 12.9
        # A stop is sent at once, and at each look that comes at least 0.5 s after the last stop.
        assert 20 <= line.sent.count("stop") <= 23

    run(scenario)


def test_a_rotctld_rotator_has_no_reference_run_no_own_tracking_and_no_faults_to_clear():
    async def scenario(driver, rotator, now):
        with pytest.raises(RefusedError, match="has no reference run of axis B"):
            await driver.home("b")
        await driver.disable_autonomy()
        assert "stop" not in rotator.received
        await driver.move_to(-30.0, 45.0)
        seen = await driver.clear_faults()
        assert rotator.received["stop"] >= 1
        assert (seen.position_a, seen.position_b) == pytest.approx(rotator.position(now()), abs=0.01)

    on_rotator(scenario)


@pytest.mark.parametrize(("state", "stow", "sentences"), [
    (STATE.replace(b"AzEl", b"Az"), (0.0, 90.0), ["of the kind Az: azimuth and elevation are needed"]),
    (STATE.replace(b"rot_type=AzEl\n", b""), (0.0, 90.0), []),
    (STATE.replace(b"360.0", b"0.0"), (0.0, 90.0), ["a range is empty: the rotator would turn azimuth 0 to 0"]),
    (STATE.replace(b"90.000000", b"0.000000"), (0.0, 90.0), ["a range is empty: the rotator would turn azimuth 0"]),
    (STATE.replace(b"90.0", b"60.0"), (0.0, 90.0), ["the stow position A 0, B 90 deg lies at azimuth"]),
    (STATE.replace(b"90.0", b"60.0").replace(b"AzEl", b"Az"), (0.0, 90.0), ["the kind Az", "the stow position A 0"]),
    (STATE.replace(b"90.0", b"60.0"), (0.0, 50.0), []),
])  # fmt: skip
def test_opening_reports_a_wrong_rotator_kind_an_empty_range_or_an_unreachable_stow_position(state, stow, sentences):
    line = Told(dump_state=state)
    found = run(lambda now: driver_on(line, now, stow).open()).setup_conflicts
    assert len(found) == len(sentences)
    assert all(sentence in said for said, sentence in zip(found, sentences, strict=True))
