"""How each fault of a schedule is caused and ended on the plant."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from functools import partial

from daemon.base.records import FaceReading, Quality, Scan
from daemon.base.timeloop import VirtualTimeLoop
from daemon.bridge.sender import pack
from daemon.rigs.campaign.plant import PLUGGABLE_DEVICES, Plant, PlantTracker, no_op
from daemon.rigs.campaign.rig import CALM_M_S, KEY
from daemon.rigs.campaign.rotator import DEAF, GONE, SENT_AWAY, STOPLESS
from daemon.rigs.campaign.taps import SleeplessUnit
from sim_drivers.pozsol.core import FAULTS as UNIT_FAULTS

Value = tuple[float, ...]
Call = Callable[[PlantTracker, Value], Awaitable[None] | None]
_PlantCall = Callable[[Plant, Value], Awaitable[None] | None]

FORGED_W_M2 = 1234.5
"""The irradiance of every face in a forged scan."""
_FORGER_ADDRESS = ("127.0.0.1", 9)
_FORGED_EVERY_S = 1.0


@dataclass(frozen=True, slots=True)
class PlantFault:
    """One fault.

    Attributes
    ----------
    begin, end
        Called with a tracker and the event's value; `end` is None for a fault that is over at once.
    may_move
        The unit may begin to move by itself.
    by_hand
        A person moves the unit.
    may_lose_counts
        The unit may lose counts without reporting it.
    is_shared
        It concerns what all trackers share: whichever tracker it is called with, it happens to all.
    """

    begin: Call
    end: Call | None = None
    may_move: bool = False
    by_hand: bool = False
    may_lose_counts: bool = False
    is_shared: bool = False


def _shared_fault(begin: _PlantCall, end: _PlantCall | None = None) -> PlantFault:
    return PlantFault(_by_plant(begin), None if end is None else _by_plant(end), is_shared=True)


def _by_plant(call: _PlantCall) -> Call:
    return lambda mount, value: call(mount.plant, value)


def _injected_fault(name: str, *, lasting: bool, may_move: bool = False, by_hand: bool = False) -> PlantFault:
    if name not in UNIT_FAULTS:
        raise ValueError(f"the simulated positioner has no fault {name!r}")

    begin, end = partial(_inject, name=name), partial(_repair, name=name)
    may_lose_counts = name == "undervoltage" or name.endswith(("hall_loss", "slip", "pulse_loss"))
    return PlantFault(
        begin, end if lasting else None, may_move=may_move, by_hand=by_hand, may_lose_counts=may_lose_counts
    )


def _unplugged_fault(device: str) -> PlantFault:
    return _shared_fault(
        lambda plant, _value: plant.plug(device, up=False),
        lambda plant, _value: plant.plug(device, up=True),
    )


async def _restart_unit(mount: PlantTracker, _value: Value, *, keep_position: bool) -> None:
    """Switch the unit off and on: its USB is gone for a second."""
    assert isinstance(mount.unit, SleeplessUnit)  # noqa: S101 - narrowing; it is no fault of a rotator
    mount.plug(up=False)
    mount.unit.power_cycle(mount.clock.monotonic(), keep_position=keep_position)
    await asyncio.sleep(1.0)
    mount.plug(up=True)


def _silence(mount: PlantTracker, _value: Value, *, silent: bool) -> None:
    mount.silence(silent=silent)


def _inject(mount: PlantTracker, _value: Value, *, name: str) -> None:
    mount.unit.inject(name, mount.clock.monotonic())


def _repair(mount: PlantTracker, _value: Value, *, name: str) -> None:
    mount.unit.repair(name, mount.clock.monotonic())


def _lose(mount: PlantTracker, _value: Value, *, is_gone: bool) -> None:
    mount.set_rotator_gone(is_gone=is_gone)


def _wind(plant: Plant, value: Value) -> None:
    plant.wind_m_s = value[0]


def _silence_wind(plant: Plant, _value: Value) -> None:
    if plant.wind_m_s is not None:
        plant.wind_m_s, plant.wind_silent_since_s = None, plant.clock.monotonic()


def _calm(plant: Plant, _value: Value) -> None:
    plant.wind_m_s = CALM_M_S


def _delay_meter(plant: Plant, value: Value) -> None:
    plant.meter.reply_delay_s = value[0]


def _hurry_meter(plant: Plant, _value: Value) -> None:
    plant.meter.reply_delay_s = 0.0


def _disturb_sensors(plant: Plant, value: Value) -> None:
    plant.noise_v = value[0]


def _calm_sensors(plant: Plant, _value: Value) -> None:
    plant.noise_v = 0.0


def _step_clock(plant: Plant, value: Value) -> None:
    plant.clock.step_s = value[0]


def _set_clock_right(plant: Plant, _value: Value) -> None:
    plant.clock.step_s = 0.0


_OPENS_WITHIN_S = 0.05


class _Bridge:
    """Stands in the place of the bridge's sender, and loses, delays or repeats scans."""

    def __init__(self, plant: Plant, kind: str, delay_s: float = 0.0) -> None:
        sender = plant.service.sender
        assert sender is not None  # noqa: S101 - narrowing; looked at before
        self.kept = sender
        self.statistics = sender.statistics
        self.open, self.close = sender.open, sender.close
        self._kind, self._delay_s = kind, delay_s
        self._last: Scan | None = None

    def send(self, scan: Scan) -> None:
        """Lose, delay or repeat a scan, as the fault does."""
        if self._kind == "lost":
            return
        if self._kind == "late":
            asyncio.get_running_loop().call_later(self._delay_s, self._send_late, scan)
            return
        self.kept.send(scan)
        self.kept.send(scan)
        if self._last is not None:
            self.kept.send(self._last)
        self._last = scan

    def _send_late(self, scan: Scan) -> None:
        # The process that had the sender may be gone.
        with contextlib.suppress(RuntimeError):
            self.kept.send(scan)


def _call_when_renewed(plant: Plant) -> None:
    plant.on_new_process()


def _disturb_bridge(plant: Plant, value: Value, *, kind: str) -> None:
    # The network's fault goes on when the process ends and another one begins.
    plant.on_new_process = partial(_disturb_bridge, plant, value, kind=kind)
    sender: object = plant.service.sender
    if sender is None:
        # The sender opens a moment after the service has begun. By then the network may be right again.
        asyncio.get_running_loop().call_later(_OPENS_WITHIN_S, _call_when_renewed, plant)
    elif not isinstance(sender, _Bridge):
        plant.service.sender = _Bridge(plant, kind, *value)  # type: ignore[assignment] # it passes for the sender


def _set_bridge_right(plant: Plant, _value: Value) -> None:
    plant.on_new_process = no_op
    sender: object = plant.service.sender
    if isinstance(sender, _Bridge):
        plant.service.sender = sender.kept


def _forgeries(plant: Plant) -> Iterator[bytes]:
    """Yield datagrams that must not be believed: one that is no scan, one signed with another key, one unsigned."""
    utc_s, now_s = plant.clock.utc(), plant.clock.monotonic()
    face = FaceReading(irradiance_w_m2=FORGED_W_M2, quality=Quality.OK, time_utc_s=utc_s, time_monotonic_s=now_s)
    scan = Scan(
        source=plant.settings.cube.name,
        session="f" * 16,
        sequence=10**6,
        time_utc_s=utc_s,
        time_monotonic_s=now_s,
        east=face,
        south=face,
        west=face,
        zenith=face._replace(irradiance_w_m2=FORGED_W_M2),
        simulated=True,
    )
    yield b"\x00\xff" * 40
    yield pack(scan, KEY[::-1])
    yield pack(scan, None)


async def _forge(plant: Plant, value: Value) -> None:
    for _ in range(int(value[0])):
        receiver = plant.service.receiver
        if plant.is_served and receiver is not None:
            for datagram in _forgeries(plant):
                receiver.datagram_received(datagram, _FORGER_ADDRESS)
        await asyncio.sleep(_FORGED_EVERY_S)


def _fill_disk(plant: Plant, _value: Value, *, full: bool) -> None:
    plant.disk.is_full = full


async def _kill_while_writing(plant: Plant, value: Value) -> None:
    """Kill the process and cut one of its kept files, as if it died while writing; no file system should allow that."""
    await plant.kill()
    files = plant.kept_files()
    if files:
        torn = files[int(value[0]) % len(files)]
        torn.write_bytes(torn.read_bytes()[: int(value[1])])


def _suspend(plant: Plant, value: Value) -> None:
    """Let the process stand still while the world goes on."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualTimeLoop)  # noqa: S101 - narrowing; no plant has another
    loop.skip(value[0])
    plant.resumed_s = plant.clock.monotonic()
    for mount in plant.mounts:
        mount.witness.note_link_change()


def _sleep(plant: Plant, value: Value) -> None:
    plant.sleep(value[0])


async def _kill(plant: Plant, _value: Value) -> None:
    await plant.kill()


async def _end(plant: Plant, _value: Value) -> None:
    await plant.end()


def _replace_process(plant: Plant, _value: Value) -> None:
    plant.start_new_process()


_AXIS_LASTING = ("hall_loss", "cable", "switch_closed", "switch_open", "ignores_targets")
_AXIS_AT_ONCE = ("overcurrent", "pulse_loss", "destination", "slip")
PROCESS_FAULTS = ("kill", "kill_torn", "end")
"""Faults that end the process and start another one."""
FACE_FAULTS = ("face_stuck", "face_shaded")
"""Faults of one face: the first number of their value says of which."""

FAULTS: dict[str, PlantFault] = {
    "unplug_positioner": PlantFault(
        lambda mount, _value: mount.plug(up=False), lambda mount, _value: mount.plug(up=True)
    ),
    **{f"unplug_{device}": _unplugged_fault(device) for device in PLUGGABLE_DEVICES},
    "deaf": _injected_fault("deaf", lasting=True),
    "positioner_silent": PlantFault(partial(_silence, silent=True), partial(_silence, silent=False)),
    GONE: PlantFault(partial(_lose, is_gone=True), partial(_lose, is_gone=False)),
    STOPLESS: PlantFault(partial(_inject, name=STOPLESS), partial(_repair, name=STOPLESS)),
    "undervoltage": _injected_fault("undervoltage", lasting=True),
    "own_tracking": _injected_fault("own_tracking", lasting=True, may_move=True),
    "slave_mode": _injected_fault("slave_mode", lasting=True, may_move=True),
    "slave_standby": _injected_fault("slave_standby", lasting=True),
    "re_reference": _injected_fault("re_reference", lasting=False, may_move=True),
    **{name: _injected_fault(name, lasting=True, by_hand=True) for name in ("button", "button_in", "buttons_both")},
    "unit_wind": _injected_fault("wind", lasting=True, may_move=True),
    "unit_snow": _injected_fault("snow", lasting=True, may_move=True),
    **{f"{axis}_{kind}": _injected_fault(f"{axis}_{kind}", lasting=True) for axis in "ab" for kind in _AXIS_LASTING},
    **{f"{axis}_{kind}": _injected_fault(f"{axis}_{kind}", lasting=False) for axis in "ab" for kind in _AXIS_AT_ONCE},
    "reset_position_kept": PlantFault(partial(_restart_unit, keep_position=True)),
    "reset_position_lost": PlantFault(partial(_restart_unit, keep_position=False)),
    "wind": _shared_fault(_wind, _calm),
    "wind_silent": _shared_fault(_silence_wind, _calm),
    "clock_step": _shared_fault(_step_clock, _set_clock_right),
    "face_stuck": _shared_fault(
        lambda plant, value: plant.scene.break_sensor(int(value[0]), value[1]),
        lambda plant, value: plant.scene.repair_sensor(int(value[0])),
    ),
    "face_shaded": _shared_fault(
        lambda plant, value: plant.scene.shade(int(value[0]), value[1]),
        lambda plant, value: plant.scene.shade(int(value[0]), 1.0),
    ),
    "face_noise": _shared_fault(_disturb_sensors, _calm_sensors),
    "meter_frozen": _shared_fault(
        lambda plant, _value: plant.meter.freeze(), lambda plant, _value: plant.meter.freeze(is_frozen=False)
    ),
    "meter_garbled": _shared_fault(lambda plant, value: plant.meter.corrupt_next(int(value[0]))),
    "meter_cut": _shared_fault(lambda plant, value: plant.meter.cut_next(int(value[0]))),
    "meter_mute": _shared_fault(lambda plant, value: plant.meter.drop_next(int(value[0]))),
    "meter_late": _shared_fault(_delay_meter, _hurry_meter),
    "meter_restart": _shared_fault(lambda plant, _value: plant.meter.power_cycle(plant.clock.monotonic())),
    "switch_fails": _shared_fault(lambda plant, value: plant.switch.fail_next(times=int(value[0]))),
    "switch_reset": _shared_fault(lambda plant, _value: plant.switch.power_cycle(plant.clock.monotonic())),
    "switch_line_stuck": _shared_fault(
        lambda plant, value: plant.switch.stick(int(value[0]), bool(value[1]), plant.clock.monotonic()),
        lambda plant, _value: plant.switch.unstick(plant.clock.monotonic()),
    ),
    "bridge_lost": _shared_fault(partial(_disturb_bridge, kind="lost"), _set_bridge_right),
    "bridge_late": _shared_fault(partial(_disturb_bridge, kind="late"), _set_bridge_right),
    "bridge_replayed": _shared_fault(partial(_disturb_bridge, kind="replayed"), _set_bridge_right),
    "bridge_forged": _shared_fault(_forge),
    "disk_full": _shared_fault(partial(_fill_disk, full=True), partial(_fill_disk, full=False)),
    "kill": _shared_fault(_kill, _replace_process),
    "kill_torn": _shared_fault(_kill_while_writing, _replace_process),
    "suspended": _shared_fault(_suspend),
    "machine_sleeps": _shared_fault(_sleep),
    "end": _shared_fault(_end, _replace_process),
}
"""Every fault that a schedule may name."""
ROTATOR_PLANT_FAULTS = frozenset(
    (
        "unplug_positioner",
        "positioner_silent",
        DEAF,
        GONE,
        STOPLESS,
        SENT_AWAY,
        *(name for name, fault in FAULTS.items() if fault.is_shared),
    )
)
"""The faults that a rotator behind rotctld can have."""
