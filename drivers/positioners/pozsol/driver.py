"""The POZSOL positioner as a plug-in: its settings, and how it is built of them."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.geometry import AxisSetup, Geometry, Proportional, Triangle
from drivers.positioners.pozsol.link import PositionerLine, SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.settings import (
    AngleRange,
    DriverSettings,
    PortPath,
    PositionerSettings,
    PositionerSurroundings,
    Positive,
    SettingsConflict,
    SettingsError,
    text_schema,
    with_defaults,
)

_STEP = {"mm": 0.02, "deg": 0.02, "impulse": 1.5}
"""A Hall count and a little, for a positioner that does not tell how many counts a position unit has."""
B_OUT_BIT = {"unknown": None, "stm": wire.B_OUT_BIT_STM, "lpc": wire.B_OUT_BIT_LPC}

Banner = Annotated[str, Field(pattern=r"^[ -#%-~]{4,80}$"), text_schema("banner")]


class AxisGeometry(DriverSettings):
    """How one axis turns motor travel into an angle; keys of another unit than the positioner's are ignored."""

    low_deg: float = Field(ge=-180, le=180, description="Angle of the tracker at the low end switch, position 0.")
    arm_1_mm: Positive = Field(300.0, le=3000, description="Unit mm: one fixed side of the actuator's triangle.")
    arm_2_mm: Positive = Field(300.0, le=3000, description="Unit mm: the other fixed side.")
    apex_deg: float = Field(
        gt=-90, lt=180, description="Unit mm: angle between the fixed sides where the tracker's angle is 0."
    )
    holder_mm: float = Field(
        0.0, ge=0, le=1000, description="Unit mm: distance of the actuator from the third side, because of its clamp."
    )
    sense: Literal["raises", "lowers"] = Field(
        "raises", description="Unit mm: whether extension raises or lowers the tracker's angle."
    )
    zero_offset: float = Field(
        0.0, ge=-1000, le=1000, description="What the unit adds to every destination (field 192 or 193), in its units."
    )
    impulses_per_deg: Positive = Field(59.5, le=100000, description="Unit impulse: motor impulses per degree.")


class PozsolSettings(PositionerSettings):
    """pozsol: a POZSOL box with two actuators or slew drives, on USB."""

    port: PortPath | None = Field(
        None, examples=["/dev/heliocube-positioner"], description="USB serial port, by a name that outlives a replug."
    )
    dtr: bool = Field(
        True,
        description="Modem line DTR from opening on. Set it to false for a board that restarts when its port is opened."
        " Linux still raises it for an instant at every open.",
    )
    rts: bool = Field(True, description="Modem line RTS, likewise.")
    boot_s: float = Field(
        0.0, ge=0, le=60, description="How long the unit may take to restart when its port is opened; 0 if it does not."
    )
    boot_banner: Banner | None = Field(
        None,
        examples=["POZSOL ready"],
        description="Text that the unit prints after a restart. Whenever it appears, the reference is in doubt.",
    )
    boards: tuple[str, ...] = Field(
        ("36A1",), strict=False, min_length=1, description="Boards (field 37) that may be written to."
    )
    position_unit: Literal["mm", "deg", "impulse"] = Field(
        "mm", description="What the unit counts positions in: mm with linear actuators, deg with slew drives."
    )
    status_layout: Literal["unknown", "stm", "lpc"] = Field(
        "unknown", description="Where axis B's bits are in the status word; what B's moves show takes precedence."
    )
    a_axis: AxisGeometry = AxisGeometry(low_deg=-52.0, apex_deg=90.0)
    b_axis: AxisGeometry = AxisGeometry(low_deg=13.0, apex_deg=37.5)

    @field_validator("a_axis", "b_axis", mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Complete an axis, of which the file names only some keys, by that axis' defaults."""
        return with_defaults(cls, value, info)

    def exclusive(self) -> Mapping[str, str | None]:
        """Return the port."""
        return {"port": self.port}

    def conflicts(self, limits: AngleRange) -> Iterator[SettingsConflict]:
        """Yield each axis whose triangle does not stay between 0 and 180 deg from its low end to its limits."""
        if self.position_unit != "mm":
            return
        for axis, geometry, low_limit_deg, high_limit_deg in (
            ("a", self.a_axis, limits.a_min_deg, limits.a_max_deg),
            ("b", self.b_axis, limits.b_min_deg, limits.b_max_deg),
        ):
            angles_deg = (geometry.low_deg, low_limit_deg, high_limit_deg)
            low_deg, high_deg = min(angles_deg), max(angles_deg)
            narrow_deg, wide_deg = (low_deg, high_deg) if geometry.sense == "raises" else (-high_deg, -low_deg)
            if not (geometry.apex_deg + narrow_deg > 0 and geometry.apex_deg + wide_deg < 180):
                others = (f"{axis}_axis.low_deg", f"/limits.{axis}_min_deg", f"/limits.{axis}_max_deg")
                reason = f"makes no triangle at some angle from {low_deg:g} to {high_deg:g} deg"
                yield SettingsConflict(f"{axis}_axis.apex_deg", reason, others)

    def rests_within(self, limits: AngleRange) -> tuple[float, float]:
        """Return how far from an angle the axes rest at the most [deg]: they are sent to whole position units."""
        a, b = axis_setups(self, limits)
        return a.rests_within(), b.rests_within()


SETTINGS = PozsolSettings


def build(
    settings: PozsolSettings, surroundings: PositionerSurroundings, line: PositionerLine | None = None
) -> PozsolPositioner:
    """Return the positioner, not yet connected; `SettingsError` if no line is given and none is named."""
    if line is None:
        port = partial(open_port, port_of(settings), surroundings.tap, dtr=settings.dtr, rts=settings.rts)
        line = SerialLine(port, surroundings.monotonic, boot_s=settings.boot_s, banner=settings.boot_banner)
    return PozsolPositioner(
        line,
        surroundings.monotonic,
        *axis_setups(settings, surroundings.limits),
        boards=settings.boards,
        stale_s=settings.telemetry_stale_s,
        b_out_bit=B_OUT_BIT[settings.status_layout],
    )


def port_of(settings: PozsolSettings) -> str:
    """Return the positioner's port; `SettingsError` if the settings do not have it."""
    if settings.port is None:
        raise SettingsError(
            "instruments.positioner.port is missing: real instruments need the positioner's port, such as"
            ' "/dev/serial/by-id/usb-..." or the link that the installed udev rules make, "/dev/heliocube-positioner"'
        )
    return settings.port


def axis_setups(settings: PozsolSettings, limits: AngleRange) -> tuple[AxisSetup, AxisSetup]:
    """Return geometry and limits of the axes A and B."""
    a, b, step = settings.a_axis, settings.b_axis, _STEP[settings.position_unit]
    return (
        AxisSetup(
            geometry=_geometry(settings, a),
            minimum_deg=limits.a_min_deg,
            maximum_deg=limits.a_max_deg,
            zero_offset=a.zero_offset,
            step=step,
        ),
        AxisSetup(
            geometry=_geometry(settings, b),
            minimum_deg=limits.b_min_deg,
            maximum_deg=limits.b_max_deg,
            zero_offset=b.zero_offset,
            step=step,
        ),
    )


def _geometry(settings: PozsolSettings, axis: AxisGeometry) -> Geometry:
    if settings.position_unit == "mm":
        return Triangle(
            arm_1_mm=axis.arm_1_mm,
            arm_2_mm=axis.arm_2_mm,
            apex_deg=axis.apex_deg,
            low_deg=axis.low_deg,
            holder_mm=axis.holder_mm,
            sense=axis.sense,
        )
    units_per_deg = axis.impulses_per_deg if settings.position_unit == "impulse" else 1.0
    return Proportional(units_per_deg, axis.low_deg)
