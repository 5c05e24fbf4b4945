"""The simulated positioner, built as the configuration describes the real one."""

from dataclasses import replace

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.real import pozsol_settings
from drivers.positioners.pozsol.driver import B_OUT_BIT, AxisGeometry
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, Actuator, AxisDrive, Mechanics, Setup, SlewDrive

_RAMP_S = 0.5
"""How long the simulated motors take to reach full speed."""
_OVERTRAVEL_DEG = 2.0
"""How far the travel goes on beyond the limits."""


def build_unit(settings: Settings, clock: Clock) -> PositionerCore:
    """Return the simulated unit; `UserError` for a geometry that cannot be built."""
    speed = settings.simulation.motor_speed_mm_s
    setup = Setup(drive=AxisDrive(speed, acceleration_mm_s2=speed / _RAMP_S))
    return PositionerCore(clock.monotonic(), configured_setup(settings, setup))


def configured_setup(settings: Settings, setup: Setup) -> Setup:
    """Return a setup with the mechanics of the settings; `UserError` for a geometry that cannot be built.

    The drive of `setup` counts in mm; the returned drive turns the axes as fast, in their own position units.
    """
    positioner, limits = pozsol_settings(settings, "simulated is"), settings.limits
    layout = B_OUT_BIT[positioner.status_layout]
    try:
        a = _mechanics(settings, positioner.a_axis, A_ACTUATOR, (limits.a_min_deg, limits.a_max_deg))
        b = _mechanics(settings, positioner.b_axis, B_ACTUATOR, (limits.b_min_deg, limits.b_max_deg))
        drive = _drive(setup.drive, a)
        if positioner.position_unit == "impulse":
            # The axis can neither stand between two impulses nor be sent there.
            drive = replace(drive, counts_per_mm=1.0)
        setup = replace(setup, a_actuator=a, b_actuator=b, drive=drive)
        return setup if layout is None else replace(setup, b_out_bit=layout)
    except ValueError as error:
        raise UserError(f"instruments.positioner has a geometry that cannot be simulated: {error}") from error


def _mechanics(settings: Settings, axis: AxisGeometry, usual: Actuator, limits_deg: tuple[float, float]) -> Mechanics:
    unit = settings.instruments.positioner.position_unit
    low_limit_deg, high_limit_deg = limits_deg
    raises = unit != "mm" or axis.sense == "raises"
    if raises:
        high_deg = max(usual.high_deg, high_limit_deg + _OVERTRAVEL_DEG)
    else:
        high_deg = min(usual.low_deg, low_limit_deg - _OVERTRAVEL_DEG)
    if unit != "mm":
        per_deg = axis.impulses_per_deg if unit == "impulse" else 1.0
        return SlewDrive(per_deg, low_deg=axis.low_deg, high_deg=high_deg, zero_offset_mm=axis.zero_offset)
    return Actuator(
        axis.arm_1_mm,
        axis.arm_2_mm,
        apex_deg=axis.apex_deg,
        low_deg=axis.low_deg,
        high_deg=high_deg,
        holder_mm=axis.holder_mm,
        extension_raises_angle=raises,
        zero_offset_mm=axis.zero_offset,
    )


def _drive(drive: AxisDrive, a: Mechanics) -> AxisDrive:
    """Return a drive that turns axis A as fast as the usual actuator does, in the position units of `a`."""
    if isinstance(a, Actuator):
        return drive
    return drive.scaled(a.travel_mm / (a.high_deg - a.low_deg) / _USUAL_MM_PER_DEG)


_USUAL_MM_PER_DEG = A_ACTUATOR.travel_mm / (A_ACTUATOR.high_deg - A_ACTUATOR.low_deg)
