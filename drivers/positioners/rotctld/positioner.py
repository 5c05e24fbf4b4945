"""A rotator behind rotctld, of which only the position is believed.

The answer `RPRT 0` proves nothing: rotctld gives it even when the rotator is off. So only the positions that are read
tell whether a move has begun or ended, and whether a stop has worked. rotctld answers the commands of one connection in
turn; a stop is written at once all the same, behind what is under way, and a move that has not sent its target sends
none.

A rotator goes on to its last target when its client has gone; it may have other clients, and the last order wins.
Motion without an order of ours shows in the positions, and the caller that polls them has to judge it.
"""

import asyncio
import contextlib
from collections.abc import Callable

from drivers.errors import (
    ConnectError,
    DeadlineError,
    DeviceError,
    IdentityError,
    LinkLostError,
    ProtocolError,
    RefusedError,
    StillMovingError,
)
from drivers.interfaces import AxisName, PositionerIdentity, Telemetry
from drivers.positioners.rotctld import protocol
from drivers.positioners.rotctld.link import RotctldLine
from drivers.positioners.rotctld.mount import OVERTRAVEL_DEG, Mount, RotatorPosition, UnreachableError, angles
from drivers.positioners.rotctld.protocol import RotatorState, RotctldReply
from drivers.settings import AngleRange

_DEVICE = "positioner"
_DUMMY = 1
_STOP_EVERY_S = 0.5
_LOOK_EVERY_S = 0.15
_LAST_STOP_WITHIN_S = 0.2
_STAND_WITHIN_S = 12.0
_WITHOUT_STOP = (protocol.NOT_IMPLEMENTED, protocol.NOT_AVAILABLE)
_MOST_AZIMUTH_DEG, _LEAST_ELEVATION_DEG, _MOST_ELEVATION_DEG = 720.0, -90.0, 180.0


class RotctldPositioner:
    """A rotator, its azimuth and elevation turned into A and B and back.

    Parameters
    ----------
    line
        To rotctld; opened and closed with the positioner.
    now
        The service's monotonic time [s].
    limits
        Of A and B, for targets: on its way the rotator is held to its own range.
    mount_of
        Makes the mount from what rotctld says of its rotator.
    stow
        The angles A and B [deg] that it has to be able to reach.
    model
        Hamlib's number that it has to have, or None.
    reply_within_s
        Longest wait for a reply.
    jitter_deg, still_for_s
        The rotator stands once its position has changed by no more than this for so long.
    """

    def __init__(
        self,
        line: RotctldLine,
        now: Callable[[], float],
        limits: AngleRange,
        mount_of: Callable[[RotatorState], Mount],
        *,
        stow: tuple[float, float],
        model: int | None = None,
        reply_within_s: float = 2.0,
        jitter_deg: float = 0.12,
        still_for_s: float = 0.6,
    ) -> None:
        self._line = line
        self._now = now
        self._limits = limits
        self._mount_of = mount_of
        self._stow = stow
        self._model = model
        self._reply_within_s = reply_within_s
        self._jitter_deg = jitter_deg
        self._still_for_s = still_for_s
        self._mount: Mount | None = None
        self._aim: RotatorPosition | None = None
        # From the last position read on this connection.
        self._azimuth_deg: float | None = None
        self._stops = 0

    @property
    def mount(self) -> Mount | None:
        """The rotator's range, None before the first `open`."""
        return self._mount

    async def open(self) -> PositionerIdentity:
        """Connect, identify and read a position; sends nothing that could move an axis."""
        await self.close()
        try:
            await self._line.open()
            info = await self._ask(protocol.GET_INFO)
            state = _state(await self._ask(protocol.DUMP_STATE))
            self._require_model(state)
            self._mount = self._mount_of(state)
            await self._position()
        except (LinkLostError, ProtocolError) as error:
            await self.close()
            raise ConnectError(_DEVICE, error.message) from error
        except BaseException:
            await self.close()
            raise
        name = info.values.get(protocol.INFO, "")
        return PositionerIdentity(
            board=name or "rotator",
            firmware=f"Hamlib model {state.model}",
            serial="",
            simulated=self._line.simulated or state.model == _DUMMY,
            setup_conflicts=self._conflicts(state, self._mount),
        )

    async def close(self) -> None:
        """Release the line; a move goes on."""
        self._aim = self._azimuth_deg = None
        await self._line.close()

    async def read_telemetry(self) -> Telemetry:
        """Ask where it points; `LinkLostError` when rotctld is silent or does not reach its rotator."""
        asked_s = self._now()
        here = await self._position()
        aim = self._aim or here
        a_deg, b_deg = angles(*here, self._known_mount().equator_azimuth_deg)
        return Telemetry(
            time_monotonic_s=asked_s,
            a_deg=a_deg,
            b_deg=b_deg,
            position_a=here.azimuth_deg,
            position_b=here.elevation_deg,
            destination_a=aim.azimuth_deg,
            destination_b=aim.elevation_deg,
            status_monotonic_s=asked_s,
            details={"azimuth_deg": here.azimuth_deg, "elevation_deg": here.elevation_deg},
        )

    async def disable_autonomy(self) -> None:
        """Do nothing: rotctld has no mode that moves by itself."""

    async def move_to(self, a_deg: float, b_deg: float, *, first: AxisName = "a") -> None:  # noqa: ARG002 - both at once
        """Send the target once the present position is known, and return when rotctld has taken it.

        Raises `ValueError` for angles outside the limits, and `RefusedError` for a place that the rotator cannot reach.
        """
        limits = self._limits
        # Written so that NaN fails.
        if not (limits.a_min_deg <= a_deg <= limits.a_max_deg and limits.b_min_deg <= b_deg <= limits.b_max_deg):
            raise ValueError(
                f"target A {a_deg}, B {b_deg} deg is outside the limits (A {limits.a_min_deg:g} to"
                f" {limits.a_max_deg:g}, B {limits.b_min_deg:g} to {limits.b_max_deg:g} deg)"
            )
        stops, here = self._stops, await self._position()
        try:
            aim = self._known_mount().place(a_deg, b_deg, here)
        except UnreachableError as error:
            message = f"is not given the target A {a_deg:z.1f}, B {b_deg:z.1f} deg: it lies at {error}"
            raise RefusedError(_DEVICE, message) from None
        if self._stops != stops:
            raise RefusedError(_DEVICE, "a stop came in between")
        self._aim = aim
        reply = await self._ask(protocol.SET_POSITION, *aim)
        if reply.error:
            self._aim = None
            look = "; are rotctld's limits (-C) and offsets (-o) right?" if reply.error in protocol.REFUSALS else ""
            raise RefusedError(
                _DEVICE,
                f"did not take azimuth {aim.azimuth_deg:z.2f}, elevation {aim.elevation_deg:z.2f} deg:"
                f" {protocol.error_text(reply.error)}{look}",
            )

    async def stop(self) -> None:
        """Send stop now; a move that has not sent its target sends none."""
        self._stops += 1
        self._aim = None
        reply = await self._ask(protocol.STOP)
        if reply.error in _WITHOUT_STOP:
            # A rotator without a stop is sent to where it is, which ends its move as well.
            here = await self._position()
            reply = await self._ask(protocol.SET_POSITION, *here)
            inside = self._known_mount().nearest(here)
            if reply.error in protocol.REFUSALS and _is_near(here, inside):
                reply = await self._ask(protocol.SET_POSITION, *inside)
            if reply.error in protocol.REFUSALS:
                # rotctld refuses, and if the rotator goes on `halt` sees it. Far outside its range no stop may turn it.
                return
        if reply.error:
            raise self._unreached_error(reply.command, reply.error)

    async def halt(self) -> None:
        """Send stop every 0.5 s until positions show that the rotator stands, within 12 s plus `still_for_s`."""
        begin_s = self._now()
        await self.stop()
        stopped_s, (still_s, anchor) = self._now(), (self._now(), await self._position())
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            here, now_s = await self._position(), self._now()
            if not self._same(here, anchor):
                still_s, anchor = now_s, here
            if now_s - still_s >= self._still_for_s:
                return
            if now_s - begin_s > _STAND_WITHIN_S + self._still_for_s:
                where = f"azimuth {here.azimuth_deg:z.1f}, elevation {here.elevation_deg:z.1f} deg"
                raise StillMovingError(_DEVICE, f"keeps moving after {now_s - begin_s:.0f} s of stops, at {where}")
            if now_s - stopped_s >= _STOP_EVERY_S:
                stopped_s = now_s
                await self.stop()

    async def home(self, axis: AxisName) -> None:
        """Refuse: rotctld has no reference run."""
        raise RefusedError(_DEVICE, f"has no reference run of axis {axis.upper()}: rotctld knows none")

    async def clear_faults(self, *, forgive: bool = True) -> Telemetry:  # noqa: ARG002 - it keeps no doubts of its own
        """Halt and return a look: rotctld latches nothing."""
        await self.halt()
        return await self.read_telemetry()

    def _require_model(self, state: RotatorState) -> None:
        if self._model is not None and state.model != self._model:
            message = f"is Hamlib's model {state.model}, but instruments.positioner.model is {self._model}"
            raise IdentityError(_DEVICE, message)

    def _conflicts(self, state: RotatorState, mount: Mount) -> tuple[str, ...]:
        texts = []
        if state.kind and state.kind != "AzEl":
            texts.append(f"rotctld says that its rotator is of the kind {state.kind}: azimuth and elevation are needed")
        if not (mount.azimuth_min_deg < mount.azimuth_max_deg and mount.elevation_min_deg < mount.elevation_max_deg):
            texts.append(f"a range is empty: the rotator would turn {mount}")
            return tuple(texts)
        try:
            mount.place(*self._stow)
        except UnreachableError as error:
            texts.append(
                f"the stow position A {self._stow[0]:g}, B {self._stow[1]:g} deg lies at {error}: correct the range"
                " (rotctld -C, or azimuth and elevation in instruments.positioner) or safety.stow_a_deg and stow_b_deg"
            )
        return tuple(texts)

    async def _position(self) -> RotatorPosition:
        reply = await self._ask(protocol.GET_POSITION)
        if reply.error:
            raise self._unreached_error(protocol.GET_POSITION, reply.error)
        try:
            azimuth_deg, elevation_deg = reply.number(protocol.AZIMUTH), reply.number(protocol.ELEVATION)
        except ValueError as error:
            raise ProtocolError(_DEVICE, f"reports no position that can be read: {error}") from None
        if not (abs(azimuth_deg) <= _MOST_AZIMUTH_DEG and _LEAST_ELEVATION_DEG <= elevation_deg <= _MOST_ELEVATION_DEG):
            raise ProtocolError(
                _DEVICE, f"reports azimuth {azimuth_deg:g}, elevation {elevation_deg:g} deg, which cannot be"
            )
        self._azimuth_deg = self._known_mount().unwrap_azimuth(azimuth_deg, self._azimuth_deg)
        return RotatorPosition(self._azimuth_deg, elevation_deg)

    async def _ask(self, name: str, *arguments: float) -> RotctldReply:
        try:
            reply = await self._line.ask(protocol.command(name, *arguments), self._reply_within_s)
        except DeadlineError as error:
            # The answer may still come, and would be taken for that of another command.
            await self._stop_and_close()
            raise LinkLostError(_DEVICE, f"{error.message}: is it rotctld, and does its rotator answer?") from None
        if reply.command != name:
            await self._stop_and_close()
            raise ProtocolError(_DEVICE, f"answers {reply.command or 'without a name'} to {name}: is it rotctld?")
        return reply

    async def _stop_and_close(self) -> None:
        """Close the line, after a stop if a target was sent: that also ends a target which rotctld has yet to read."""
        if self._aim is not None:
            with contextlib.suppress(DeviceError):
                await self._line.ask(protocol.command(protocol.STOP), _LAST_STOP_WITHIN_S)
        await self._line.close()

    def _unreached_error(self, name: str, error: int) -> DeviceError:
        return LinkLostError(
            _DEVICE,
            f"rotctld answers {name} with {protocol.error_text(error)}: look at the rotator and its cable, then restart"
            " rotctld, which opens its port only once",
        )

    def _known_mount(self) -> Mount:
        if self._mount is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        return self._mount

    def _same(self, one: RotatorPosition, other: RotatorPosition) -> bool:
        return all(abs(here - there) <= self._jitter_deg for here, there in zip(one, other, strict=True))


def _is_near(here: RotatorPosition, inside: RotatorPosition) -> bool:
    """Tell whether a position lies outside of the range by no more than a rotator's run-out."""
    return here != inside and all(abs(one - other) <= OVERTRAVEL_DEG for one, other in zip(here, inside, strict=True))


def _state(reply: RotctldReply) -> RotatorState:
    if reply.error:
        raise ProtocolError(_DEVICE, f"rotctld answers dump_state with {protocol.error_text(reply.error)}")
    try:
        return protocol.parse_state(reply)
    except ValueError as error:
        raise ProtocolError(_DEVICE, f"rotctld's dump_state cannot be read: {error}") from None
