"""Whatever bytes come in whatever order, the axes stay on their tracks, and reading them changes nothing."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol.wire import Field, encode_command
from sim_drivers.pozsol.core import FAULTS, PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR
from solar.frames import Angles
from tests.sim_drivers.pozsol.exchange import CLEAR, HOME_A, HOME_B, JOG_A_OUT, STOP, TRACKING_OFF, own, status


def test_an_idle_unit_has_one_event_left_at_900_s_and_then_none():
    core = PositionerCore()
    assert core.next_event(0.0) == 900.0
    assert core.next_event(86_400.0) is None


COMMANDS = st.one_of(
    st.floats(-60, 60).map(lambda a: encode_command(Field.A_ANGLE, a)),
    st.floats(10, 95).map(lambda b: encode_command(Field.B_ANGLE, b)),
    st.sampled_from([STOP, CLEAR, HOME_A, HOME_B, TRACKING_OFF, JOG_A_OUT, b"$93\r", b"$8Y\r", b"$7\r"]),
    st.binary(max_size=80),
)
FAULT = st.sampled_from(FAULTS)
STEPS = st.lists(st.tuples(st.floats(0, 50), st.one_of(COMMANDS, FAULT)), max_size=12)
ENDS = ((A_ACTUATOR, -1.0), (B_ACTUATOR, -1.0))


@given(STEPS)
def test_axes_stay_within_their_travel_and_screens_readable_after_any_commands_and_faults(steps):
    core, now = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0))), 0.0
    for wait, step in steps:
        now += wait
        if isinstance(step, bytes):
            core.feed(step, now)
        else:
            core.inject(step, now)
        status(core, now)
        for (actuator, low_mm), angle_deg in zip(ENDS, core.truth(now), strict=True):
            position = actuator.position_mm(angle_deg)
            assert low_mm - 1e-6 <= position <= actuator.travel_mm - low_mm + 1e-6


@given(STEPS, st.integers(1, 40))
def test_the_unit_behaves_the_same_however_often_it_is_advanced(steps, looks):
    seldom, often, now = PositionerCore(setup=own()), PositionerCore(setup=own()), 0.0
    for wait, step in steps:
        for i in range(1, looks):
            often.advance(now + wait * i / looks)
        now += wait
        for core in (seldom, often):
            if isinstance(step, bytes):
                core.feed(step, now)
            else:
                core.inject(step, now)
    assert seldom.screens(now + 30.0) == often.screens(now + 30.0)
    assert seldom.truth(now + 30.0) == often.truth(now + 30.0)
