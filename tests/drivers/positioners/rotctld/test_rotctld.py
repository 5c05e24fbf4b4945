"""The driver and Hamlib's own rotctld with its dummy rotator: 6 deg/s on both axes, in real time."""

import asyncio
import time

import pytest

from drivers.errors import ConnectError, IdentityError, LinkLostError, RefusedError
from drivers.positioners.rotctld.driver import RotctldSettings, build
from drivers.positioners.rotctld.mount import angles
from drivers.settings import PositionerSurroundings
from drivers.transcript import no_tap
from solar.frames import Limits
from tests.support import PATIENCE_S

LIMITS = Limits()


def driver_of(place, stow=(0.0, 90.0), tap=no_tap, equator_deg=180.0, **settings):
    around = PositionerSurroundings(
        limits=LIMITS,
        monotonic=time.monotonic,
        tap=tap,
        stow=stow,
        equator_azimuth_deg=equator_deg,
    )
    return build(RotctldSettings(driver="rotctld", server=place, **settings), around)


@pytest.fixture
def run():
    """Return a function that runs `act` with a driver and closes the driver at the end."""

    def outer(driver, act):
        async def inner():
            try:
                return await act(driver)
            finally:
                await driver.close()

        return asyncio.run(inner())

    return outer


async def until_it_turns(driver):
    async with asyncio.timeout(PATIENCE_S):
        while True:
            if (await driver.read_telemetry()).position_a >= 2.0:
                return
            await asyncio.sleep(0.05)


async def read_for_ever(driver):
    async with asyncio.timeout(PATIENCE_S):
        while True:
            await driver.read_telemetry()


async def arrive(driver, a_deg, b_deg):
    async with asyncio.timeout(PATIENCE_S):
        while True:
            seen = await driver.read_telemetry()
            if (seen.a_deg, seen.b_deg) == pytest.approx((a_deg, b_deg), abs=0.05):
                return seen
            await asyncio.sleep(0.05)


def test_the_dummy_rotator_of_hamlib_is_identified_and_marked_as_simulated(start_rotctld, run):
    async def act(driver):
        return await driver.open()

    identity = run(driver_of(start_rotctld().place), act)
    assert (identity.board, identity.firmware) == ("Dummy rotator", "Hamlib model 1")
    assert (identity.simulated, identity.setup_conflicts) == (True, ())


@pytest.mark.parametrize(("equator_deg", "azimuth_deg"), [(180.0, 140.77), (0.0, 39.23)])
def test_a_target_is_reached_and_shown_in_the_tracker_s_angles(start_rotctld, run, equator_deg, azimuth_deg):
    # With these offsets the dummy begins near its target, and rotctld reports wrong limits.
    server = start_rotctld("-o", f"{6 - azimuth_deg}", "-O", "-35")

    async def act(driver):
        await driver.open()
        begin = await driver.read_telemetry()
        assert (begin.a_deg, begin.b_deg) == pytest.approx(angles(azimuth_deg - 6, 35, equator_deg), abs=0.01)
        await driver.move_to(-30.0, 45.0)
        going = await driver.read_telemetry()
        seen = await arrive(driver, -30.0, 45.0)
        assert (going.destination_a, going.destination_b) == (seen.destination_a, seen.destination_b)
        assert (seen.destination_a, seen.destination_b) == pytest.approx((azimuth_deg, 37.76), abs=0.01)
        # The dummy takes a while for the last twentieth of a degree.
        async with asyncio.timeout(PATIENCE_S):
            while server.azimuth_deg() != pytest.approx(azimuth_deg, abs=0.02):  # noqa: ASYNC110 - it tells nobody
                await asyncio.sleep(0.05)

    turns = {"azimuth_min_deg": 0.0, "azimuth_max_deg": 360.0, "elevation_min_deg": 35.0, "elevation_max_deg": 90.0}
    run(driver_of(server.place, equator_deg=equator_deg, **turns), act)


def test_a_stop_is_sent_after_a_move_that_is_not_answered_yet_and_both_are_understood(start_rotctld, run):
    pieces, stops = [], []

    def tap(way, data):
        pieces.append((way, data))
        if b"set_pos" in data and way == ">":
            # The move cannot have been answered yet.
            stops.append(asyncio.ensure_future(driver.stop()))

    async def act(driver):
        await driver.open()
        await driver.move_to(0.0, 45.0)
        await asyncio.gather(*stops)
        stands = await driver.read_telemetry()
        await asyncio.sleep(0.5)
        return stands, await driver.read_telemetry()

    driver = driver_of(start_rotctld().place, tap=tap)
    stands, later = run(driver, act)
    assert len(stops) == 1
    assert (stands.position_a, stands.position_b) == (later.position_a, later.position_b)
    assert later.position_a < 90.0
    order = [data for way, data in pieces if b"set_pos" in data or b"stop" in data]
    assert order[:2] == [b"+\\set_pos 180.00 45.00\n", b"+\\stop\n"]
    # Each command is a write of its own.
    assert all(data.count(b"\n") == 1 for way, data in pieces if way == ">")


def test_a_halt_ends_a_move_and_nothing_moves_afterwards(start_rotctld, run):
    async def act(driver):
        await driver.open()
        await driver.move_to(0.0, 45.0)
        await until_it_turns(driver)
        await driver.halt()
        before = await driver.read_telemetry()
        await asyncio.sleep(0.7)
        return before, await driver.read_telemetry()

    before, after = run(driver_of(start_rotctld().place), act)
    assert 2.0 <= before.position_a < 120.0
    assert after.position_a == before.position_a == after.destination_a


NARROW = ("-C", "min_az=100,max_az=260,min_el=10,max_el=60")


def test_a_stow_position_beyond_the_range_is_reported_and_one_within_it_is_accepted(start_rotctld, run):
    server = start_rotctld(*NARROW)

    async def act(driver):
        return (await driver.open()).setup_conflicts

    (sentence,) = run(driver_of(server.place), act)
    assert sentence.startswith("the stow position A 0, B 90 deg lies at azimuth")
    assert "the rotator turns azimuth 100 to 260 and elevation 10 to 60 deg: correct the range" in sentence
    assert run(driver_of(server.place, stow=(0.0, 50.0)), act) == ()


def test_each_target_is_checked_against_the_range_by_the_driver_and_by_rotctld(start_rotctld, run):
    server = start_rotctld(*NARROW)

    async def act(driver):
        await driver.open()
        with pytest.raises(ValueError, match="outside the limits"):
            await driver.move_to(51.0, 45.0)
        with pytest.raises(ValueError, match="outside the limits"):
            await driver.move_to(float("nan"), 45.0)
        with pytest.raises(RefusedError) as caught:
            await driver.move_to(0.0, 75.0)
        return caught.value.message

    assert "lies at azimuth 180.0, elevation 75.0 deg, but the rotator turns" in run(driver_of(server.place), act)
    # A wider range in the configuration is believed, and rotctld has the last word.
    wide = driver_of(server.place, elevation_max_deg=90.0)
    assert run(wide, act) == (
        "did not take azimuth 180.00, elevation 75.00 deg: invalid parameter (RPRT -1);"
        " are rotctld's limits (-C) and offsets (-o) right?"
    )


def test_the_configured_range_counts_when_offsets_make_the_limits_of_rotctld_wrong(start_rotctld, run):
    # With an offset of 100 rotctld says 100 to 460, and takes -100 to 260.
    server = start_rotctld("-o", "100", "-C", "min_az=0,max_az=360")
    server.ask("P 100 45\n", b"RPRT")

    async def act(driver):
        await driver.open()
        await driver.move_to(0.0, 45.0)
        await driver.halt()

    run(driver_of(server.place, azimuth_min_deg=-100.0, azimuth_max_deg=260.0), act)
    with pytest.raises(RefusedError, match="did not take azimuth 273"):
        # West of the azimuths that rotctld takes, but within the limits that it reports.
        run(driver_of(server.place), refuse_in_the_west)


async def refuse_in_the_west(driver):
    await driver.open()
    driver._limits = Limits(a_max_deg=80.0, b_max_deg=180.0)
    await driver.move_to(70.0, 100.0)


def test_a_killed_rotctld_is_a_lost_link_at_once_and_a_restarted_one_can_be_opened_again(start_rotctld, run):
    server = start_rotctld()

    async def act(driver):
        await driver.open()
        server.kill()
        with pytest.raises(LinkLostError, match="closed the connection"):
            await read_for_ever(driver)
        with pytest.raises(ConnectError, match="nothing listens at 127"):
            await driver.open()
        await asyncio.to_thread(server.start)
        await driver.open()
        return await driver.read_telemetry()

    assert run(driver_of(server.place), act).position_a == 0.0


def test_a_rotctld_that_hangs_is_given_up_at_the_deadline(start_rotctld, run):
    server = start_rotctld()

    async def act(driver):
        await driver.open()
        server.hang()
        try:
            with pytest.raises(LinkLostError, match=r"did not answer get_pos within 0.5 s"):
                await driver.read_telemetry()
            with pytest.raises(LinkLostError, match="has to be opened first"):
                await driver.stop()
            with pytest.raises(ConnectError, match="did not answer get_info"):
                await driver.open()
        finally:
            server.resume()
        await driver.open()

    run(driver_of(server.place, telemetry_stale_s=0.5), act)


def test_a_rotator_of_another_model_than_the_configured_one_is_refused(start_rotctld, run):
    async def act(driver):
        await driver.open()

    with pytest.raises(IdentityError, match=r"Hamlib's model 1, but instruments\.positioner\.model is 603"):
        run(driver_of(start_rotctld().place, model=603), act)


def test_a_rotator_that_its_rotctld_cannot_reach_is_reported_with_the_remedy(start_rotctld, run):
    # Model 2 asks another rotctld. If that one is gone, every question about the rotator ends in an error.
    far = start_rotctld()
    near = start_rotctld("-m", "2", "-r", far.place)

    async def act(driver):
        await driver.open()
        far.kill()
        with pytest.raises(LinkLostError, match=r"rotctld answers get_pos with .*restart\s+rotctld|did not answer"):
            await read_for_ever(driver)

    run(driver_of(near.place, telemetry_stale_s=10.0), act)


@pytest.mark.parametrize(
    ("greeting", "sentence"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n", "did not answer get_info"),
        (b"", "did not answer get_info"),
        (b"RPRT 0\n", "answers without a name to get_info|sent an answer that nobody asked for"),
    ],
)
def test_a_server_that_is_not_rotctld_is_refused_at_opening(run, greeting, sentence):
    async def serve():
        async def peer(reader, writer):
            writer.write(greeting)
            await reader.read(100)
            await asyncio.sleep(0.5)
            writer.close()

        server = await asyncio.start_server(peer, "127.0.0.1", 0)
        driver = driver_of(f"127.0.0.1:{server.sockets[0].getsockname()[1]}", telemetry_stale_s=0.5)
        try:
            with pytest.raises(ConnectError, match=sentence):
                await driver.open()
        finally:
            await driver.close()
            server.close()
            await asyncio.sleep(0.6)

    asyncio.run(serve())
