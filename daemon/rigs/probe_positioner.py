"""The probe of the real positioner: identity, stream, settings, geometry, own modes, and small timed moves."""

import asyncio
import os
from collections import Counter
from collections.abc import Callable
from typing import Any

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.first_look import LONG_ENOUGH_S, check_noted_obstacles, watch_telemetry
from daemon.rigs.real import positioner_surroundings, pozsol_settings
from drivers.errors import RefusedError
from drivers.interfaces import AxisName, PositionerIdentity, Telemetry
from drivers.positioners.pozsol import driver
from drivers.positioners.pozsol.geometry import AxisSetup
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.unit_setup import missing_fields
from drivers.positioners.pozsol.wire import Field, TokenStream, own_moves
from drivers.settings import SettingsError
from drivers.transcript import Direction, Tap

Say = Callable[[str], object]

_SHEET = (*range(70, 80), 83, *range(96, 108), *range(110, 114), 117, 118, *range(121, 128), 192, 193, 194)
_LOOK_EVERY_S = 0.1
_STILL_S = 2.0
_MOVE_WITHIN_S = 120.0
# A unit loses a packet now and then. Like the service, the probe tries a move again.
_TRIES = 3
_BY_HAND = (
    "still to be done by hand (docs/hardware.md):",
    "  capture the writes of the maker's or the former program with usbmon: code, last byte, pacing, checksum",
    "  pull the USB cable during a move: does the axis go on to its target? (expected: yes)",
    "  switch the motor supply off and on: is the position kept?",
)


async def probe_positioner(
    settings: Settings, clock: Clock, seconds: float, move_deg: float | None, tap: Tap, say: Say
) -> dict[str, Any]:
    """Listen to the positioner and report; with `move_deg`, also move each axis by that much and back.

    Returns, for scripts, its identity with conflicts with the configuration, its telemetry, geometry and settings.

    Raises
    ------
    UserError
        The positioner is of another make, or the settings do not say where it is.
    DeviceError
        The positioner cannot be reached, is another board, or does not do as it should.
    """
    heard = _FieldCounter(tap)
    own = pozsol_settings(settings, "heliocube probe positioner speaks to")
    surroundings = positioner_surroundings(settings, clock, heard)
    setups = driver.axis_setups(own, surroundings.limits)
    try:
        positioner = driver.build(own, surroundings)
    except SettingsError as error:
        raise UserError(str(error)) from None
    say(f"port: {own.port}, {_usb_device(own.port or '')}")
    try:
        identity = await positioner.open()
        say(_modem_lines(own, positioner))
        say(f"board {identity.board}, firmware {identity.firmware}, serial {identity.serial}")
        start_s = clock.monotonic()
        heard.counts.clear()
        telemetry = await watch_telemetry(
            positioner, clock, seconds if move_deg is None else max(seconds, LONG_ENOUGH_S)
        )
        _report_stream(heard.counts, clock.monotonic() - start_s, say)
        fields = positioner.fields()
        _report_state(telemetry, fields, say)
        _report_geometry(telemetry, setups, say)
        _report_setup(identity, fields, say)
        say("configuration sheet: " + ", ".join(f"{code}={fields[code]}" for code in _SHEET if code in fields))
        if move_deg is not None:
            if identity.setup_conflicts:
                raise RefusedError("positioner", "is not moved while it contradicts the configuration, as said above")
            check_noted_obstacles(settings, telemetry)
            await _time_moves(positioner, setups, move_deg, clock, say)
        for line in _BY_HAND:
            say(line)
        return {
            "port": own.port,
            "identity": identity,
            "telemetry": telemetry,
            "geometry_fits": _geometry_fits(telemetry, setups),
            "own_moves": tuple(own_moves(fields)),
            "fields": {str(code): text for code, text in sorted(fields.items())},
        }
    finally:
        await positioner.close()


class _FieldCounter:
    """Counts the fields that are received; called in the reader's thread."""

    def __init__(self, tap: Tap) -> None:
        self.counts: Counter[int] = Counter()
        self._tap = tap
        self._stream = TokenStream()

    def __call__(self, direction: Direction, data: bytes) -> None:
        self._tap(direction, data)
        if direction == "<":
            self.counts.update(code for code, _ in self._stream.feed(data))


def _usb_device(path: str) -> str:
    from serial.tools import list_ports  # noqa: PLC0415 - needs what not every machine has

    name = os.path.realpath(path)
    for port in list_ports.comports():
        if port.device == name and port.vid is not None:
            text = f"USB {port.vid:04x}:{port.pid:04x}, {port.manufacturer} {port.product}, serial {port.serial_number}"
            return text if (port.vid, port.pid) == (0x0483, 0x5740) else f"{text} (expected is 0483:5740)"
    return "no USB device that this machine knows of"


def _modem_lines(wanted: driver.PozsolSettings, positioner: PozsolPositioner) -> str:
    if not positioner.has_modem_lines():
        return "modem lines: the port has none, so instruments.positioner.dtr and rts have no effect"
    return f"modem lines: DTR {'on' if wanted.dtr else 'off'}, RTS {'on' if wanted.rts else 'off'}"


def _report_stream(counts: Counter[int], seconds: float, say: Say) -> None:
    angles = counts[Field.A_ANGLE]
    say(f"stream: {sum(counts.values()) / seconds:.0f} fields/s, {len(counts)} different ones in {seconds:.0f} s")
    if angles:
        say(f"  angle A every {seconds / angles * 1e3:.0f} ms (expected 120), status {counts[Field.STATUS]} times")
    wanted = (Field.SUPPLY, Field.A_ANGLE, Field.A_POSITION, Field.B_ANGLE, Field.B_POSITION, Field.STATUS)
    missing = [field.name for field in wanted if not counts[field]]
    if missing:
        say(f"  did not come in this time: {', '.join(missing)}")


def _report_state(telemetry: Telemetry, fields: dict[int, str], say: Say) -> None:
    say(
        f"A {telemetry.a_deg:z.1f} deg at {telemetry.position_a:g}, B {telemetry.b_deg:z.1f} deg at"
        f" {telemetry.position_b:g}; supply {telemetry.supply_v:g} V; mode '{telemetry.details['mode']}'"
    )
    states = {
        f"faults: {', '.join(telemetry.faults)}": bool(telemetry.faults),
        "it has restarted since its status was cleared: the reference is in doubt": telemetry.was_reset,
        "a button on the box is being pressed": telemetry.button_pressed,
        f"end switches closed: {telemetry.details.get('end_switches')}": "end_switches" in telemetry.details,
        "its own tracking, wind or snow mode is ON: it may move by itself": telemetry.autonomous,
    }
    for text, present in states.items():
        if present:
            say(f"  {text}")
    for setting in own_moves(fields):
        say(f"  set in the unit, which may move by itself: {setting}")


def _geometry_fits(telemetry: Telemetry, setups: tuple[AxisSetup, AxisSetup]) -> dict[str, bool]:
    return {name: setup.fits(angle_deg, position) for name, setup, angle_deg, position in _axes(telemetry, setups)}


def _axes(
    telemetry: Telemetry, setups: tuple[AxisSetup, AxisSetup]
) -> tuple[tuple[AxisName, AxisSetup, float, float], ...]:
    return (
        ("a", setups[0], telemetry.a_deg, telemetry.position_a),
        ("b", setups[1], telemetry.b_deg, telemetry.position_b),
    )


def _report_geometry(telemetry: Telemetry, setups: tuple[AxisSetup, AxisSetup], say: Say) -> None:
    for name, setup, angle_deg, position in _axes(telemetry, setups):
        expected = setup.geometry.position(angle_deg)
        if setup.fits(angle_deg, position):
            fits = f"geometry of {name.upper()} fits"
            say(f"{fits}: {angle_deg:z.1f} deg is {expected:z.1f}, and the unit shows {position:g}")
        else:
            say(
                f"geometry of {name.upper()} does NOT fit: instruments.positioner.{name}_axis makes {expected:z.1f} of"
                f" {angle_deg:z.1f} deg, and the unit shows {position:g}; no move will be made"
            )


def _report_setup(identity: PositionerIdentity, fields: dict[int, str], say: Say) -> None:
    compared = "geometry (70-77, 83, 96-103, 107), zero offsets (192, 193) and ranges (79, 105, 110, 111)"
    for conflict in identity.setup_conflicts:
        say(f"  CONFLICT, nothing will be moved: {conflict}")
    missing = ", ".join(str(code) for code in missing_fields(fields))
    if missing:
        say(f"  fields that did not come as numbers, so they were not compared: {missing}")
    if not identity.setup_conflicts:
        say(f"its {compared} agree with the configuration as far as they came")


async def _time_moves(
    positioner: PozsolPositioner, setups: tuple[AxisSetup, AxisSetup], move_deg: float, clock: Clock, say: Say
) -> None:
    try:
        await positioner.halt()
        await positioner.disable_autonomy()
        start = await positioner.read_telemetry()
        _refuse_pressed(start)
        if start.needs_homing:
            raise RefusedError("positioner", f"is not moved before it is homed, because of: {start.needs_homing}")
        if not (setups[0].allows(start.a_deg) and setups[1].allows(start.b_deg)):
            raise RefusedError("positioner", "stands outside the configured limits, so it is not moved from there")
        axes: tuple[tuple[AxisName, float, float], ...] = (
            ("a", start.a_deg, _offset_deg("a", setups[0], start.a_deg, move_deg)),
            ("b", start.b_deg, _offset_deg("b", setups[1], start.b_deg, move_deg)),
        )
        for axis, here_deg, way in axes:
            for target_deg in (here_deg + way, here_deg):
                targets = (target_deg, start.b_deg) if axis == "a" else (start.a_deg, target_deg)
                await _order(positioner, targets, say)
                say(f"  {axis.upper()} to {target_deg:z.1f} deg: {await _watch(positioner, axis, clock)}")
    finally:
        await positioner.halt()


def _refuse_pressed(seen: Telemetry) -> None:
    if seen.button_pressed:
        raise RefusedError("positioner", "is not moved on: a button on its box is pressed, so somebody is there")


def _offset_deg(axis: AxisName, setup: AxisSetup, here_deg: float, move_deg: float) -> float:
    """Return how far to move an axis, up or down; `RefusedError` if its limits have no room either way."""
    for way in (move_deg, -move_deg):
        if setup.allows(here_deg + way):
            return way
    raise RefusedError(
        "positioner",
        f"is not moved: {axis.upper()} stands at {here_deg:z.1f} deg, and its limits, {setup.minimum_deg:g} to"
        f" {setup.maximum_deg:g} deg, leave no room for {move_deg:g} deg either way",
    )


async def _order(positioner: PozsolPositioner, targets: tuple[float, float], say: Say) -> None:
    """Order a move, and repeat the order, up to `_TRIES` times in all, if the unit does not take it."""
    for _ in range(_TRIES - 1):
        try:
            await positioner.move_to(*targets)
        except RefusedError as error:
            say(f"  {error.message}; it is tried again")
        else:
            return
    await positioner.move_to(*targets)


def _why_given_up(*, stands: bool) -> str:
    if stands:
        return f"has told nothing of its buttons in the {_MOVE_WITHIN_S:g} s of a move, so nothing more is moved"
    limit = f"still moves after {_MOVE_WITHIN_S:g} s, so it was stopped"
    return f"{limit}: a smaller --move-deg is enough for a slow drive"


async def _watch(positioner: PozsolPositioner, axis: AxisName, clock: Clock) -> str:
    """Follow one axis until it stands, and return what was seen; `RefusedError` if the probe must move no more."""
    begin_s = last_s = first_s = clock.monotonic()
    seen = await positioner.read_telemetry()
    start = position = seen.position_a if axis == "a" else seen.position_b
    start_deg = seen.a_deg if axis == "a" else seen.b_deg
    # Wait for a status after the last motion: the unit reports its buttons later than its position, and the axes may
    # stand because somebody has pressed one.
    while clock.monotonic() < last_s + _STILL_S or seen.status_monotonic_s <= last_s:
        if clock.monotonic() >= begin_s + _MOVE_WITHIN_S:
            raise RefusedError("positioner", _why_given_up(stands=clock.monotonic() >= last_s + _STILL_S))
        await asyncio.sleep(_LOOK_EVERY_S)
        seen = await positioner.read_telemetry()
        _refuse_pressed(seen)
        if seen.needs_homing:
            raise RefusedError("positioner", f"was stopped in its move, because of: {seen.needs_homing}")
        now_position = seen.position_a if axis == "a" else seen.position_b
        if now_position != position:
            if position == start:
                first_s = clock.monotonic()
            position, last_s = now_position, clock.monotonic()
    end_deg, took_s = (seen.a_deg if axis == "a" else seen.b_deg), max(last_s - first_s, _LOOK_EVERY_S)
    if position == start:
        return "it did not move"
    return (
        f"began after {first_s - begin_s:.1f} s, took {took_s:.1f} s, {abs(position - start) / took_s:.2f} units/s,"
        f" {abs(end_deg - start_deg) / took_s:.2f} deg/s, stands at {end_deg:z.1f} deg, position {position:g}"
    )
