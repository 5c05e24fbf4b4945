"""What the unit prints about itself, in which order and with how many decimals."""

from drivers.positioners.pozsol.wire import Field, TokenStream
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.screens import SLOW_SCREENS
from sim_drivers.pozsol.setup import Actuator, Setup
from solar.frames import Angles
from tests.sim_drivers.pozsol.exchange import HOME_B, fields, point


def test_screens_come_in_six_slots_with_27_slow_ones_in_turn():
    core = PositionerCore()
    screens = [core.next_screen(i * 0.02) for i in range(6 * 27)]
    firsts = [screen[1] for screen in screens[:5]]
    assert firsts == [Field.CLOCK_HOUR, Field.A_ANGLE, Field.B_ANGLE, Field.GMT_SECOND, Field.GMT_MONTH]
    slow = screens[5::6]
    assert [screen[1] for screen in slow] == [group[0] for group in SLOW_SCREENS]
    assert len(set(slow)) == 27
    assert all(len(screen) <= 255 and screen.startswith(b"$") for screen in screens)
    again = [core.next_screen(10.0)[1] for _ in range(6)]
    assert again == [*firsts, SLOW_SCREENS[0][0]]


def test_the_screens_identify_the_unit_and_print_the_documented_decimals():
    text = fields(PositionerCore(), 0.0)
    assert text[Field.BOARD] == b"36A1"
    assert text[Field.VERSION].endswith(b"(B1.100)")
    assert [len(group) for group in text[Field.SERIAL].split(b"-")] == [8, 8, 8, 8]
    assert text[Field.STATUS] == b"0000"
    assert text[Field.MODE] == b"tracker ok"
    assert text[Field.SUPPLY] == b"24.00"


def test_geometry_is_printed_as_the_firmware_understands_it():
    lowers = Actuator(300.0, 280.0, 60.0, 40.0, -30.0, holder_mm=39.6, extension_raises_angle=False, zero_offset_mm=1.5)
    text = fields(PositionerCore(setup=Setup(b_actuator=lowers, start=Angles(0.0, 0.0))), 0.0)
    assert [text[code] for code in range(70, 81)] == (
        [b"195.3", b"300.0", b"300.0", b"0.0", b"0.0", b"1.0", b"-90.0", b"0.0", b"75.0", b"376", b"2"]
    )
    stator = f"{lowers.stator_mm:.1f}".encode()
    assert [text[code] for code in range(96, 104)] == (
        [stator, b"300.0", b"280.0", b"0.0", b"39.6", b"0.0", b"120.0", b"0.0"]
    )
    assert (text[192], text[193]) == (b"0.00", b"1.50")
    assert {text[code] for code in (108, 109, 122, 123, 126, 127)} == {b"off"}


def test_the_live_screens_say_the_same_as_all_screens():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    every = fields(core, 3.0)
    live = dict(TokenStream().feed(core.live_screens(3.0) + b"$"))
    assert {Field.A_POSITION, Field.B_DESTINATION, Field.SUPPLY, Field.MODE, Field.STATUS} <= set(live)
    assert all(every[code] == value for code, value in live.items())


def test_axis_b_shows_its_motion_in_the_status_bits_of_the_configured_layout():
    core = PositionerCore(setup=Setup(b_out_bit=16))
    core.feed(HOME_B, 0.0)
    word = int(fields(core, 1.0)[Field.STATUS])
    assert word == 1 << 17 | 1 << 18
