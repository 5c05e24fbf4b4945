"""How each fault of a schedule is caused and ended on the plant.

A fault that the simulator does not know is refused before anything runs: a campaign that skips what it cannot do would
report a clean run of things that never happened.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from sim_drivers.pozsol.core import FAULTS as UNIT_FAULTS


class CannotDoError(Exception):
    """A schedule asks for something that simulator or service cannot do, in one sentence."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes
    ----------
    begin, end
        Called with the plant and the event's value; `end` is None for what is over at once.
    unit_name
        The name that the simulated unit has for it, or empty.
    moves
        The unit may begin to move by itself.
    by_hand
        A person moves it.
    uncounts
        The unit may lose counts without a word.
    """

    begin: Callable
    end: Callable | None = None
    unit_name: str = ""
    moves: bool = False
    by_hand: bool = False
    uncounts: bool = False


def _injected(name, *, lasting, **kind):
    def begin(plant, value):
        plant.unit.inject(name, plant.clock.monotonic())

    def end(plant, value):
        plant.unit.repair(name, plant.clock.monotonic())

    return Fault(begin, end if lasting else None, name, **kind)


def _unplugged(device):
    return Fault(
        lambda plant, value: plant.plug(device, up=False),
        lambda plant, value: plant.plug(device, up=True),
    )


async def _restart_unit(plant, *, keep_position):
    """Off and on: the unit's USB is gone for a second."""
    plant.plug("positioner", up=False)
    plant.unit.power_cycle(plant.clock.monotonic(), keep_position=keep_position)
    await asyncio.sleep(1.0)
    plant.plug("positioner", up=True)


def _set(name, begun, ended):
    return Fault(
        lambda plant, value: setattr(plant, name, begun(value)), lambda plant, value: setattr(plant, name, ended)
    )


def _freeze_meter(plant, value):
    # What it shows at this moment is what it shows from now on.
    shown_v = plant.switch.output_voltage(plant.clock.monotonic())
    plant.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, shown_v)


def _thaw_meter(plant, value):
    vars(plant.voltmeter).pop("read_voltage", None)


def _break_face(plant, value):
    plant.scene.break_sensor(int(value[0]), value[1])


def _step_clock(plant, value):
    plant.clock.step_s = value[0]


def _set_clock_right(plant, value):
    plant.clock.step_s = 0.0


async def _kill_while_writing(plant, value):
    """Die in the middle of writing one of the kept files, as no file system should let it happen."""
    await plant.kill()
    files = plant.kept_files()
    if files:
        torn = files[int(value[0]) % len(files)]
        torn.write_bytes(torn.read_bytes()[: int(value[1])])


def _suspend(plant, value):
    """Let the process stand still while the world goes on."""
    asyncio.get_running_loop().skip(value[0])
    plant.watch.link_changes()


async def _replace_process(plant, value):
    plant.renew()


FAULTS = {
    "unplug_positioner": _unplugged("positioner"),
    "unplug_multiplexer": _unplugged("multiplexer"),
    "unplug_voltmeter": _unplugged("voltmeter"),
    "deaf": _injected("deaf", lasting=True),
    "undervoltage": _injected("undervoltage", lasting=True, uncounts=True),
    "own_tracking": _injected("own_tracking", lasting=True, moves=True),
    "slave_mode": _injected("slave_mode", lasting=True, moves=True),
    "slave_standby": _injected("slave_standby", lasting=True),
    "re_reference": _injected("re_reference", lasting=False, moves=True),
    **{name: _injected(name, lasting=True, by_hand=True) for name in ("button", "button_in", "buttons_both")},
    "unit_wind": _injected("wind", lasting=True, moves=True),
    "unit_snow": _injected("snow", lasting=True, moves=True),
    **{
        f"{axis}_{kind}": _injected(f"{axis}_{kind}", lasting=True, uncounts=kind == "hall_loss")
        for axis in "ab"
        for kind in ("hall_loss", "cable", "switch_closed", "switch_open", "ignores_targets")
    },
    **{
        f"{axis}_{kind}": _injected(f"{axis}_{kind}", lasting=False, uncounts=kind in ("slip", "pulse_loss"))
        for axis in "ab"
        for kind in ("overcurrent", "pulse_loss", "destination", "slip")
    },
    "reset_position_kept": Fault(
        lambda plant, value: _restart_unit(plant, keep_position=True), None, "reset_position_kept"
    ),
    "reset_position_lost": Fault(
        lambda plant, value: _restart_unit(plant, keep_position=False), None, "reset_position_lost"
    ),
    "wind": _set("wind_m_s", lambda value: value[0], 3.0),
    "wind_silent": _set("wind_m_s", lambda value: None, 3.0),
    "clock_step": Fault(_step_clock, _set_clock_right),
    "face_stuck": Fault(_break_face, lambda plant, value: plant.scene.repair_sensor(int(value[0]))),
    "face_shaded": Fault(
        lambda plant, value: plant.scene.shade(int(value[0]), value[1]),
        lambda plant, value: plant.scene.shade(int(value[0]), 1.0),
    ),
    "meter_frozen": Fault(_freeze_meter, _thaw_meter),
    "meter_garbled": Fault(lambda plant, value: plant.meter.corrupt_next(int(value[0]))),
    "meter_mute": Fault(lambda plant, value: plant.meter.drop_next(int(value[0]))),
    "meter_late": Fault(
        lambda plant, value: setattr(plant.meter, "reply_delay_s", value[0]),
        lambda plant, value: setattr(plant.meter, "reply_delay_s", 0.0),
    ),
    "meter_restart": Fault(lambda plant, value: plant.meter.power_cycle(plant.clock.monotonic())),
    "switch_fails": Fault(lambda plant, value: plant.switch.fail_next(times=int(value[0]))),
    "switch_reset": Fault(lambda plant, value: plant.switch.power_cycle(plant.clock.monotonic())),
    "switch_line_stuck": Fault(
        lambda plant, value: plant.switch.stick(int(value[0]), bool(value[1]), plant.clock.monotonic()),
        lambda plant, value: plant.switch.unstick(plant.clock.monotonic()),
    ),
    "kill": Fault(lambda plant, value: plant.kill(), _replace_process),
    "kill_torn": Fault(_kill_while_writing, _replace_process),
    "suspended": Fault(_suspend),
    "end": Fault(lambda plant, value: plant.end(), _replace_process),
}
"""Every fault that a schedule may name."""


def refuse_unknown(schedule, commands):
    """Raise `CannotDoError` for the first event that simulator or service does not know."""
    for event in schedule.events:
        if event.what == "command":
            if event.name not in commands:
                raise CannotDoError(
                    f"the service has no command '{event.name}'; leave it out with --without {event.name}"
                )
            continue
        fault = FAULTS.get(event.name)
        if fault is None:
            raise CannotDoError(f"the campaign has no fault '{event.name}'; it has {', '.join(FAULTS)}")
        if fault.unit_name and fault.unit_name not in UNIT_FAULTS:
            raise CannotDoError(f"the simulated unit has no fault '{fault.unit_name}'; leave out {event.name}")
