"""What the positioner's driver learns about a unit that it opens, and what it sends first, in virtual time."""

import asyncio
import itertools
import math
from dataclasses import replace

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import ConnectError, IdentityError, LinkLostError, RefusedError, StillMovingError
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.table import Value
from drivers.positioners.pozsol.unit_setup import missing_fields
from drivers.positioners.pozsol.wire import B_HIGH_BIT_STM, B_OUT_BIT_STM, Field, encode_command
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, Setup
from sim_drivers.transports import InMemoryStream
from solar.frames import Angles

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)
STOP = encode_command(Field.ACTION, wire.STOP)


class Unit(InMemoryStream):
    """The simulated unit's line, on which some fields have other values, or come late or, at infinity, never."""

    def __init__(self, core, now, says=None, comes_s=None):
        super().__init__(core, now)
        self.core, self.now = core, now
        self.says, self.comes_s = says or {}, comes_s or {}
        self.restarted_s = None
        self.sent = []

    async def send(self, packet):
        self.sent.append((self.now(), packet))
        await super().send(packet)

    def state(self):
        state, now_s = super().state(), self.now()
        said = {code: Value(text, now_s, _number(text)) for code, text in self.says.items()}
        values = {code: one for code, one in (dict(state.values) | said).items() if now_s >= self.comes_s.get(code, 0)}
        return state._replace(values=values, restarted_s=self.restarted_s)


def _number(text):
    try:
        return float(text)
    except ValueError:
        return math.nan


def on_unit(scenario, a=A, setup=None, stale_s=2.0, **unit):
    """Run a scenario with a driver that is not open yet, its unit, and a function that returns the time."""

    async def scene():
        now = asyncio.get_running_loop().time
        line = Unit(PositionerCore(now(), setup), now, **unit)
        await scenario(PozsolPositioner(line, now, a, B, stale_s=stale_s), line, now)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


async def fails_after(action, now, seconds, error, match):
    begin_s = now()
    with pytest.raises(error, match=match):
        await action
    assert now() - begin_s == pytest.approx(seconds, abs=0.05)


def test_opening_refuses_another_board_and_nothing_is_ever_sent_to_it():
    async def scenario(positioner, unit, now):
        sentence = "says it is board '37B2', not 36A1: nothing is sent to it"
        await fails_after(positioner.open(), now, 0.0, IdentityError, sentence)
        for attempt in (positioner.stop, positioner.halt, positioner.read_telemetry):
            with pytest.raises(LinkLostError):
                await attempt()
        assert unit.sent == []

    on_unit(scenario, says={Field.BOARD: b"37B2"})


def test_a_stop_is_not_sent_while_the_unit_has_not_been_identified():
    async def scenario(positioner, unit, _):
        opening = asyncio.ensure_future(positioner.open())
        await asyncio.sleep(1.0)
        with pytest.raises(LinkLostError, match="has not been identified, so nothing is sent to it"):
            await positioner.stop()
        assert unit.sent == []
        identity = await opening
        assert (identity.board, identity.simulated) == ("36A1", True)
        await positioner.stop()
        assert [packet for _, packet in unit.sent] == [STOP, STOP]

    on_unit(scenario, comes_s={Field.SERIAL: 2.0})


def test_opening_fails_within_seconds_for_a_silent_unit_and_a_little_later_if_fields_are_missing():
    async def silent(positioner, unit, now):
        unit.silent = True
        await fails_after(positioner.open(), now, 2.54, ConnectError, "sends no telemetry: it hangs")
        unit.boot_s = 3.0
        await fails_after(positioner.open(), now, 5.54, ConnectError, "sends no telemetry")

    async def lacking(positioner, unit, now):
        sentence = "sends something, but not the fields 87, 136 of a positioner"
        await fails_after(positioner.open(), now, 8.02, IdentityError, sentence)
        unit.restarted_s = now() + 4.0
        await fails_after(positioner.open(), now, 12.02, IdentityError, sentence)

    on_unit(silent)
    on_unit(lacking, comes_s={Field.SERIAL: math.inf, Field.STATUS: math.inf})


def test_opening_waits_for_telemetry_as_long_as_the_configured_silence_allows():
    async def scenario(positioner, unit, now):
        assert (await positioner.open()).board == "36A1"
        assert missing_fields(positioner.fields()) == ()
        unit.silent = True
        await fails_after(positioner.open(), now, 30.02, ConnectError, "sends no telemetry")

    on_unit(scenario, stale_s=30.0, comes_s={Field.SERIAL: 20.0, 192: 25.0})


@pytest.mark.parametrize(("comes_s", "seconds", "told"), [(3.0, 3.0, 1), (math.inf, 4.5, 0), (0.0, 0.0, 1)])
def test_opening_waits_for_missing_setup_fields_for_one_turn_of_the_slow_screens(comes_s, seconds, told):
    async def scenario(positioner, _, now):
        identity = await positioner.open()
        assert now() == pytest.approx(seconds, abs=0.05)
        assert len([text for text in identity.setup_conflicts if "zero_offset" in text]) == told
        assert missing_fields(positioner.fields()) == (() if told else (192,))

    on_unit(scenario, replace(A, zero_offset=2.0), comes_s={192: comes_s})


def test_reopening_reports_an_unfinished_reference_run_and_sends_the_first_stop_twice_again():
    async def scenario(positioner, unit, now):
        await positioner.open()
        await positioner.move_to(-30.0, 45.0)
        await positioner.home("a")
        await asyncio.sleep(2.0)
        await positioner.close()
        unit.restarted_s = now()
        unit.sent.clear()
        await positioner.open()
        seen = await positioner.read_telemetry()
        assert seen.reference_doubt == "the reference run of A did not end; the positioner has restarted"
        await positioner.stop()
        assert [packet for _, packet in unit.sent] == [STOP, STOP]
        await positioner.open()
        await positioner.move_to(0.0, 45.0)
        assert unit.sent[2][1] == STOP

    on_unit(scenario)


def test_before_the_first_opening_nothing_is_sent():
    async def scenario(positioner, unit, _):
        for attempt in (positioner.stop(), positioner.halt(), positioner.move_to(0.0, 45.0), positioner.home("a")):
            with pytest.raises(LinkLostError):
                await attempt
        assert unit.sent == []

    on_unit(scenario)


def test_commands_are_sent_a_pause_apart_with_a_stop_before_the_first():
    async def scenario(positioner, unit, now):
        await positioner.open()
        await positioner.move_to(-30.0, 45.0)
        await positioner.move_to(-20.0, 50.0, first="b")
        times = [at_s for at_s, _ in unit.sent]
        assert all(later - before >= wire.COMMAND_SPACING_S - 1e-6 for before, later in itertools.pairwise(times))
        assert times[2] - times[0] < 3 * wire.COMMAND_SPACING_S
        codes = [packet.strip(b"\x00")[:2] for _, packet in unit.sent]
        assert unit.sent[0][1] == STOP
        assert codes[1:3] == [unit.sent[1][1][:2], unit.sent[2][1][:2]]
        assert codes[3:5] == codes[2:0:-1]
        assert now() < 2.0

    on_unit(scenario)


def test_a_stop_is_sent_at_once_and_twice_only_where_the_first_packet_may_be_lost():
    async def scenario(positioner, unit, now):
        await positioner.open()
        begin_s = now()
        await positioner.stop()
        assert [at_s - begin_s for at_s, _ in unit.sent] == pytest.approx([0.0, wire.COMMAND_SPACING_S], abs=1e-5)
        await positioner.stop()
        assert len(unit.sent) == 3

    on_unit(scenario)


@pytest.mark.parametrize("act", ["move", "home", "clear", "quieten"])
def test_a_stop_ends_any_move_homing_clear_or_disable_autonomy_and_no_more_is_sent(act):
    async def scenario(positioner, unit, _):
        await positioner.open()
        await positioner.stop()
        if act == "quieten":
            unit.core.inject("own_tracking", unit.now())
            await asyncio.sleep(10.0)
        started = {
            "move": lambda: positioner.move_to(-30.0, 45.0),
            "home": lambda: positioner.home("a"),
            "clear": positioner.clear_faults,
            "quieten": positioner.disable_autonomy,
        }[act]()
        task = asyncio.ensure_future(started)
        await asyncio.sleep(0.01)
        await positioner.stop()
        count = len(unit.sent)
        with pytest.raises(RefusedError, match="a stop came in between"):
            await task
        assert len(unit.sent) == count
        assert unit.sent[-1][1] == STOP

    on_unit(scenario, setup=Setup(own_target=lambda _now: Angles(-40.0, 20.0)))


@pytest.mark.parametrize(("says", "fault", "why"), [
    ({}, "a_ignores_targets", r"and \S+ and no reason; was its motor supply low until just now, or is the geometry"),
    ({Field.SUPPLY: b"19.90"}, "a_ignores_targets", "its motor supply is 19.9 V"),
    ({Field.SUPPLY: b"20.00"}, "a_ignores_targets", "and no reason"),
    ({Field.MODE: b"wind"}, "a_ignores_targets", "and no reason|its own mode is on"),
])  # fmt: skip
def test_a_move_whose_target_was_not_taken_is_refused_with_its_likely_cause(says, fault, why):
    async def scenario(positioner, unit, now):
        await positioner.open()
        unit.core.inject(fault, now())
        begin_s = now()
        with pytest.raises(RefusedError, match=f"did not take the target A -30.00, B 45.00 deg .*: .*{why}"):
            await positioner.move_to(-30.0, 45.0)
        assert 1.0 <= now() - begin_s < 1.4
        assert unit.sent[-1][1] == STOP

    on_unit(scenario, says=says)


def test_a_move_is_refused_and_not_sent_when_shown_angle_and_position_do_not_fit_the_geometry():
    async def scenario(positioner, unit, _):
        await positioner.open()
        with pytest.raises(
            RefusedError, match=r"it shows \S+ deg at position \S+ of axis A, but by instruments\.positioner"
        ):
            await positioner.move_to(-30.0, 45.0)
        assert unit.sent == []

    on_unit(scenario, says={Field.A_ANGLE: b"40.0"})


def test_halt_fails_after_12_s_if_the_unit_stands_short_of_its_destinations():
    async def scenario(positioner, unit, now):
        await positioner.open()
        sentence = r"does not accept the stop: it stands short of its destinations: A at \S+ of 300, B at \S+ of \S+"
        await fails_after(positioner.halt(), now, 12.04, StillMovingError, sentence)
        times = [at_s for at_s, _ in unit.sent]
        assert times[1] - times[0] == pytest.approx(wire.COMMAND_SPACING_S, abs=0.05)
        assert {round(later - before, 2) for before, later in itertools.pairwise(times[1:])} == {0.16}

    on_unit(scenario, says={Field.A_DESTINATION: b"300.0000"})


def test_a_tremble_of_one_hall_count_as_the_unit_reports_it_counts_as_standstill():
    async def scenario(positioner, unit, now):
        await positioner.open()
        at = float(unit.state().values[Field.A_POSITION].number)
        begin_s = now()

        async def tremble(counts):
            while True:
                for place in (at, at + counts / 75):
                    unit.says[Field.A_POSITION] = unit.says[Field.A_DESTINATION] = f"{place:.4f}".encode()
                    await asyncio.sleep(0.04)

        trembling = asyncio.ensure_future(tremble(1.0))
        await positioner.halt()
        trembling.cancel()
        assert now() - begin_s < 0.8
        trembling = asyncio.ensure_future(tremble(1.5))
        with pytest.raises(StillMovingError):
            await positioner.halt()
        trembling.cancel()

    # The unit's own word on its counts takes precedence over the configuration, which counts only without it.
    on_unit(scenario, replace(A, step=math.nan))
    on_unit(scenario, replace(A, step=0.016), says={78: b"none"})


@pytest.mark.parametrize(
    ("field", "off", "taken"),
    [
        (Field.A_DESTINATION, 0.49, True),
        (Field.A_DESTINATION, 0.51, False),
        (Field.A_DESTINATION, -0.51, False),
        (Field.B_DESTINATION, 0.49, True),
        (Field.B_DESTINATION, 0.51, False),
        (Field.B_DESTINATION, -0.51, False),
    ],
)
def test_a_target_counts_as_taken_when_both_shown_destinations_are_within_half_a_unit(field, off, taken):
    async def scenario(positioner, unit, now):
        await positioner.open()
        setup, angle_deg = {Field.A_DESTINATION: (A, -30.0), Field.B_DESTINATION: (B, 45.0)}[field]
        unit.says[field] = f"{setup.destination(angle_deg) + off:.4f}".encode()
        if taken:
            await positioner.move_to(-30.0, 45.0)
            # A screen that was already on its way when the last command was sent says nothing about that command.
            assert 0.1 < now() - unit.sent[-1][0] < 0.2
        else:
            with pytest.raises(RefusedError, match="did not take the target"):
                await positioner.move_to(-30.0, 45.0)

    on_unit(scenario)


def test_fields_returns_the_unit_fields_sorted_by_code_as_they_are_printed():
    async def scenario(positioner, unit, _):
        await positioner.open()
        assert list(positioner.fields()) == sorted(positioner.fields())
        assert positioner.fields()[Field.BOARD] == "36A1"

    on_unit(scenario, comes_s={40: 0.1})


def test_telemetry_details_contain_mode_closed_switches_their_counts_and_a_failing_memory():
    async def scenario(positioner, unit, _):
        await positioner.open()
        unit.says |= {Field.STATUS: str(1 << 19).encode(), Field.MODE: b" auto ", Field.A_REMAIN: b"1.5000"}
        unit.says[Field.B_REMAIN] = b"none"
        details = (await positioner.read_telemetry()).details
        assert details == {"mode": "auto", "end_switches": "a_low", "a_count_at_switch": 1.5}
        unit.says |= {Field.STATUS: str(1 << 30).encode(), Field.MODE: b"auto", Field.A_REMAIN: b"none"}
        details = (await positioner.read_telemetry()).details
        assert details == {"mode": "auto", "memory": "cannot be read or written"}

    on_unit(scenario)


def test_the_high_end_switch_of_axis_b_is_reported_only_once_b_has_moved():
    async def scenario(positioner, unit, _):
        await positioner.open()
        unit.says[Field.STATUS] = str(1 << B_HIGH_BIT_STM).encode()
        assert "end_switches" not in (await positioner.read_telemetry()).details
        unit.says[Field.STATUS] = str(1 << B_OUT_BIT_STM).encode()
        for step in range(4):
            unit.says[Field.B_POSITION] = f"{100 + step}.0000".encode()
            await asyncio.sleep(0.2)
            await positioner.read_telemetry()
        unit.says[Field.STATUS] = str(1 << B_HIGH_BIT_STM).encode()
        await asyncio.sleep(0.2)
        assert (await positioner.read_telemetry()).details["end_switches"] == "b_high"

    on_unit(scenario)


B_DEG = B_ACTUATOR.angle_deg(282.0)


@pytest.mark.parametrize(("b_deg", "told"), [(60.0, [b"$2195\r"]), (B_DEG, [])])
def test_an_axis_that_stands_at_its_target_is_sent_no_destination(b_deg, told):
    async def scenario(positioner, unit, _):
        await positioner.open()
        await positioner.halt()
        unit.sent.clear()
        await positioner.move_to(A_ACTUATOR.angle_deg(229.0), b_deg)
        assert [packet for _, packet in unit.sent] == told
        await asyncio.sleep(120)
        seen = await positioner.read_telemetry()
        assert (seen.faults, seen.b_deg) == ((), pytest.approx(b_deg, abs=0.2))

    on_unit(scenario, setup=Setup(start=Angles(A_ACTUATOR.angle_deg(228.75), B_DEG)))


def test_an_axis_that_stands_0_35_units_from_its_target_is_sent_the_destination():
    async def scenario(positioner, unit, _):
        await positioner.open()
        await positioner.halt()
        unit.sent.clear()
        await positioner.move_to(A_ACTUATOR.angle_deg(229.0), B_DEG)
        assert [packet for _, packet in unit.sent] == [b"$.229\r"]

    on_unit(scenario, setup=Setup(start=Angles(A_ACTUATOR.angle_deg(228.65), B_DEG)))


def test_an_axis_that_is_only_passing_its_target_is_sent_the_destination():
    async def scenario(positioner, unit, _):
        await positioner.open()
        unit.says |= {Field.A_POSITION: b"229.0000", Field.A_DESTINATION: b"300.0000"}
        unit.says[Field.A_ANGLE] = b"%.4f" % A_ACTUATOR.angle_deg(229.0)
        with pytest.raises(RefusedError, match="did not take the target"):
            await positioner.move_to(A_ACTUATOR.angle_deg(229.0), 90.0)
        assert b"$.229\r" in [packet for _, packet in unit.sent]

    on_unit(scenario)
