"""What running the firmware has shown: a test for each finding, on the firmware itself and on the simulated unit."""

import contextlib
from dataclasses import replace

import pytest

from drivers.positioners.pozsol.wire import TokenStream
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, Actuator, Setup
from solar.frames import Angles
from tests.firmware.peer import Firmware, Simulated

STOP, HOME_A, HOME_B, CLEAR, OWN_TRACKING = b"$9s\r", b"$95\r", b"$96\r", b"$\x880\r", b"$8Y\r"
A_OUT, A_IN, A_HOMING, B_HOMING, A_LOW, OWN = 1 << 11, 1 << 12, 1 << 13, 1 << 17, 1 << 19, 1 << 25
MOTION = A_OUT | A_IN | A_HOMING | B_HOMING | 1 << 15 | 1 << 16


@pytest.fixture(params=["firmware", "simulated"])
def both(request):
    """One of the two units, in the same state."""
    if request.param == "firmware":
        return request.getfixturevalue("unit")
    return Simulated.like(*request.getfixturevalue("powered_up"))


def after(unit, packet: bytes, ms: int):
    unit.feed(packet)
    unit.step(ms)
    return unit.look()


def test_the_first_packet_after_each_connection_is_lost(both):
    after(both, b"$.300\r", 1000)
    both.cause("replug")
    assert after(both, STOP, 200).motion[0] == 1
    after(both, STOP, 600)
    assert both.look().motion == (0, 0)


def test_a_supply_dip_ends_a_reference_run_without_any_report_in_the_status(both):
    assert after(both, HOME_A, 1000).status & A_HOMING
    both.cause("supply low")
    both.step(800)
    both.cause("supply back")
    both.step(2000)
    look = both.look()
    assert look.status == 0
    assert look.position_mm[0] > 200


def test_the_homing_bit_comes_with_the_first_impulse_and_goes_when_the_axis_is_stuck(both):
    assert not after(both, HOME_A, 30).status & A_HOMING
    both.step(200)
    assert both.look().status & A_HOMING
    both.cause("halls of A dead")
    both.step(1000)
    assert not both.look().status & A_HOMING
    both.step(1500)
    assert both.look().status & 0xFF == 1 << 1


def test_homing_one_axis_while_the_other_moves_leaves_the_other_without_control(both):
    after(both, b"$.300\r", 2000)
    counted = both.look().position_mm[0]
    look = after(both, HOME_B, 300)
    assert look.motion[0] == 1
    assert look.position_mm[0] == pytest.approx(counted, abs=0.2)
    both.step(4000)
    assert both.look().status & 0xFF == 1 << 1
    assert both.look().status & B_HOMING


@pytest.mark.parametrize("of", ["firmware", "simulated"])
def test_an_axis_sent_to_its_own_position_stays_on_and_faults_at_an_order_for_the_other_axis(lock_step, of):
    with contextlib.closing(Firmware(lock_step, A_ACTUATOR.angle_deg(228.96), 90.0)) as firmware:
        unit = firmware if of == "firmware" else firmware.twin()
        for _ in range(2):
            after(unit, STOP, 300)
        after(unit, b"$.229\r", 20)
        look = after(unit, b"$2200\r", 3000)
        assert look.status & 0xFF == 1 << 1
        assert look.position_mm == (pytest.approx(228.96, abs=0.01), pytest.approx(275, abs=5))


def test_homing_an_axis_that_moves_outwards_ends_early_short_of_its_switch(both):
    after(both, b"$.300\r", 2000)
    turn = both.look().position_mm[0]
    after(both, HOME_A, 12_000)
    look = both.look()
    assert not look.status & MOTION
    assert look.position_mm[0] == pytest.approx(turn + 3.2 - 10.0, abs=0.4)


# One unit for all of them: powering one up takes five times as long as sending it a number.
def test_a_negative_or_too_large_destination_is_taken_as_the_far_end(both):
    for text in (b"-5", b"-400", b"99999999999"):
        assert after(both, b"$.300\r", 100).destination_mm[0] == 300.0
        assert after(both, b"$.%s\r" % text, 100).destination_mm[0] == 376.0, text


def test_numbers_are_read_as_c_reads_them(both):
    # Only the last, which is no number at all, leaves the destination unchanged.
    numbers = [(b"1e1", 264), (b"nan", 0), (b"0x10", 283), (b"inf", 0), (b"\t10", 264), (b"", 264)]
    for text, destination_mm in numbers:
        assert after(both, b"$,%s\r" % text, 100).destination_mm[0] == destination_mm, text


def test_a_command_is_recognised_only_if_its_packet_begins_with_a_dollar(both):
    before = both.look().destination_mm
    assert after(both, b"\r$.300\r", 100).destination_mm == before
    assert after(both, b"$.300\r", 100).destination_mm[0] == 300.0


def test_after_a_stop_the_destination_is_the_position_and_no_bit_is_set_while_the_axis_runs_out(both):
    assert after(both, b"$.300\r", 2000).status == A_OUT
    look = after(both, STOP, 80)
    assert look.motion[0] == 1
    assert look.status == 0
    assert look.destination_mm[0] == pytest.approx(look.position_mm[0], abs=0.02)
    both.step(500)
    assert both.look().motion[0] == 0
    assert both.look().position_mm[0] == pytest.approx(look.position_mm[0] + 0.3, abs=0.15)


def test_during_homing_the_destination_runs_ahead_and_only_the_other_axis_takes_targets(both):
    look = after(both, HOME_A, 1000)
    assert look.destination_mm[0] == pytest.approx(look.position_mm[0] - 10.0, abs=0.05)
    assert after(both, b"$2100\r", 100).destination_mm[1] == 100.0
    assert after(both, b"$.100\r", 100).destination_mm[0] > 200.0


def test_targets_are_refused_until_five_seconds_after_an_undervoltage(both):
    both.cause("supply low")
    both.step(500)
    both.cause("supply back")
    both.step(4500)
    before = both.look().destination_mm
    assert after(both, b"$.300\r", 100).destination_mm == before
    both.step(1000)
    assert after(both, b"$.300\r", 100).destination_mm[0] == 300.0


def test_overcurrent_discards_the_target_of_its_axis_and_the_other_axis_begins_its_move(both):
    after(both, b"$.300\r", 1500)
    after(both, b"$2200\r", 500)
    both.cause("overcurrent A")
    both.step(3000)
    look = both.look()
    assert look.status & 0xFF == 1
    assert look.motion == (0, -1)
    assert look.destination_mm[0] == pytest.approx(look.position_mm[0], abs=0.02)


def test_on_a_reversal_the_axis_drives_the_old_way_for_another_second(both):
    after(both, b"$.300\r", 2000)
    turn = both.look().position_mm[0]
    look = after(both, b"$.200\r", 900)
    assert look.motion[0] == 1
    assert look.position_mm[0] == pytest.approx(turn + 2.8, abs=0.2)
    both.step(2000)
    assert both.look().motion[0] == -1


def test_the_button_shows_in_the_status_and_drives_the_axis_only_while_it_is_held(both):
    both.cause("button out")
    both.step(100)
    assert both.look().status == 1 << 9
    both.step(1000)
    assert both.look().motion[0] == 1
    both.cause("no button")
    both.step(700)
    assert both.look().status == 0
    assert both.look().motion[0] == 0


def test_the_tracking_off_command_puts_a_slave_on_standby_and_never_switches_tracking_on(both):
    both.cause("slave")
    assert after(both, b"$8Y\r", 100).status & 1 << 25
    for _ in range(2):
        assert not after(both, b"$8N\r", 100).status & 1 << 25
    assert after(both, b"$.100\r", 100).destination_mm[0] == 100.0


def test_an_unknown_action_code_ends_a_move(both):
    after(both, b"$.300\r", 1000)
    assert after(both, b"$9x\r", 250).motion[0] == 1
    both.step(500)
    assert both.look().motion[0] == 0
    assert both.look().destination_mm[0] < 240


def test_a_reference_run_ends_just_beyond_its_switch_with_the_count_set_anew(lock_step):
    firmware = Firmware(lock_step, -51.0, 90.0)
    try:
        for unit in (firmware.twin(), firmware):
            after(unit, HOME_A, 6000)
            look = unit.look()
            assert look.position_mm[0] == pytest.approx(-0.39, abs=0.05)
            assert look.status == A_LOW
            assert look.destination_mm[0] == look.position_mm[0]
            assert after(unit, CLEAR, 100).status == A_LOW
    finally:
        firmware.close()


def test_own_tracking_switched_on_in_a_reference_run_lets_it_end_and_moves_nothing_meanwhile(lock_step):
    firmware = Firmware(lock_step, -50.0, 60.0)
    try:
        for unit in (firmware.twin(), firmware):
            after(unit, HOME_A, 1000)
            before = unit.look()
            look = after(unit, OWN_TRACKING, 500)
            assert look.status == before.status | OWN
            assert (look.motion, look.position_mm[1]) == ((-1, 0), before.position_mm[1])
            assert look.destination_mm[1] != before.destination_mm[1]
            unit.step(4000)
            look = unit.look()
            assert look.position_mm == pytest.approx((-0.39, before.position_mm[1]), abs=0.05)
            assert (look.motion, look.status) == ((0, 0), A_LOW | OWN)
    finally:
        firmware.close()


def test_simulated_unit_and_firmware_print_geometry_ranges_supply_and_mode_alike(unit):
    unit.step(4000)
    theirs = unit.unit.fields()
    ours = dict(TokenStream().feed(unit.twin().core.screens(0.0) + b"$"))
    geometry = (*range(70, 81), 83, *range(96, 108), 110, 111, 192, 193)
    for code in (
        37,
        39,
        *geometry,
        44,
        45,
        46,
        48,
        49,
        50,
        56,
        58,
        63,
        64,
        108,
        109,
        112,
        113,
        122,
        123,
        126,
        127,
        136,
    ):
        assert ours[code] == theirs[code], code
    assert set(theirs) == set(ours)


@pytest.mark.parametrize(
    "actuator",
    [
        replace(A_ACTUATOR, holder_mm=39.6),
        replace(A_ACTUATOR, zero_offset_mm=5.0),
        Actuator(300.0, 280.0, 100.0, 52.0, -52.0, extension_raises_angle=False),
    ],
    ids=["holder", "zero offset", "lowers"],
)
def test_simulated_unit_and_firmware_give_targets_of_other_triangles_the_same_destinations(unit, actuator):
    angle_deg = -actuator.apex_deg if actuator.extension_raises_angle else 180.0 - actuator.apex_deg
    sides = (
        actuator.stator_mm,
        actuator.arm_1_mm,
        actuator.arm_2_mm,
        0.0,
        actuator.holder_mm,
        float(actuator.extension_raises_angle),
    )
    for code, value in [*enumerate((*sides, angle_deg, 0.0), start=70), (192, actuator.zero_offset_mm)]:
        after(unit, b"$%c%.4f\r" % (code, value), 60)
    unit.step(500)
    core, now = PositionerCore(setup=Setup(a_actuator=actuator, start=Angles(0.0, 90.0))), 0.0
    for target_deg in (-45.0, -10.0, 0.0, 20.0, 45.0):
        packet = b"$,%.1f\r" % target_deg
        theirs = after(unit, packet, 100).destination_mm[0]
        core.feed(packet, now)
        now += 0.1
        ours = dict(TokenStream().feed(core.screens(now) + b"$"))[46]
        assert float(ours) == pytest.approx(theirs, abs=0.02), target_deg


def test_a_slave_that_is_switched_to_tracking_waits_for_its_master(both):
    both.cause("slave")
    before = both.look()
    look = after(both, b"$8Y\r", 2000)
    assert look.status & 1 << 25
    assert (look.position_mm, look.destination_mm) == (before.position_mm, before.destination_mm)


def test_a_held_button_acts_first_after_320_ms_and_then_every_301_ms(both):
    both.cause("button in")
    times_ms, was = [], None
    for ms in range(0, 1600, 10):
        if ms % 60 == 0:
            both.feed(b"$.370\r")
        both.step(10)
        goes_in = both.look().destination_mm[0] == 0
        if goes_in and not was:
            times_ms.append(ms + 10)
        was = goes_in
    # The first one coincides with a command.
    assert times_ms[-4:] == [pytest.approx(320 + 301 * turn, abs=10) for turn in range(1, 5)]
