"""The settings of the service: one TOML file, every key named with its unit, every unknown key an error.

The descriptions here are the only ones: the commented file, the reference and the error messages are made from them.
"""

from functools import lru_cache
from itertools import repeat
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationInfo, field_validator

from daemon.config.instruments import Instruments
from daemon.config.links import (
    ApiSettings,
    ArchiveSettings,
    BridgeSettings,
    DashboardSettings,
    MqttSettings,
    NotifySettings,
    StoreSettings,
    SunspecSettings,
)
from daemon.config.plugin_sections import LAW, LOAD
from daemon.config.section import Duration, FilePath, NotNegative, Section
from daemon.config.simulation import SimulationSettings
from drivers.settings import LoadSettings, Positive, with_defaults
from solar.ephemeris import Site
from solar.frames import Limits
from solar.laws.law import LawSettings
from solar.rows.group import TrackerGroup

Azimuth = Annotated[float, Field(ge=0, lt=360)]
Channel = Annotated[int, Field(ge=0, le=15)]
WindSpeed = Annotated[float, Field(gt=0, le=40)]
Place = Annotated[float, Field(ge=-100000, le=100000)]
Edge = Annotated[float, Field(gt=0, le=100)]


class SiteSettings(Section):
    """Where the rig stands. The default is the paper's: SIRTA, Palaiseau."""

    name: str = Field("SIRTA", description="Name of the site, for display.")
    latitude_deg: float = Field(
        48.717607,
        ge=-90,
        le=90,
        description="Latitude, north positive; in the south the cube's south face looks north.",
    )
    longitude_deg: float = Field(2.209002, ge=-180, le=180, description="Longitude, east positive.")
    altitude_m: float = Field(156.0, ge=-430, le=9000, description="Height above sea level.")

    def place(self) -> Site:
        """Return the site as the science knows it."""
        return Site(self.latitude_deg, self.longitude_deg, self.altitude_m)


class FaceSettings(Section):
    """One sensor of the cube: irradiance = gain x (voltage - offset)."""

    channel: Channel = Field(description="Multiplexer input that the sensor is wired to.")
    gain_w_m2_per_mv: Positive = Field(
        10.0, le=1000, description="Gain. A sensor of 0.1 mV per W/m2, such as the RG100, has a gain of 10."
    )
    offset_mv: float = Field(0.0, ge=-100, le=100, description="Output voltage of the sensor in the dark.")
    azimuth_deg: Azimuth | None = Field(
        None,
        examples=[92.5],
        description="True azimuth of the face, clockwise from north: 92.5 for an east face turned by 2.5."
        " Left out: exactly the direction of its name.",
    )
    tilt_deg: float = Field(90.0, ge=0, le=180, description="Tilt of the face: 0 faces up, 90 faces the horizon.")


class CubeSettings(Section):
    """The cube and the rhythm in which its four faces are read."""

    name: str = Field(
        "cube",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$",
        json_schema_extra={"format": "name"},
        description="Name that every scan carries to the trackers.",
    )
    scan_every_s: float = Field(5.0, ge=0.5, le=60, description="Time from the start of one scan to the next.")
    reading_deadline_s: Positive = Field(
        2.0, le=60, description="Longest wait for one reading after the multiplexer has settled."
    )
    minimum_w_m2: float = Field(-20.0, ge=-100, le=0, description="Readings below are implausible and not used.")
    maximum_w_m2: float = Field(1500.0, ge=500, le=3000, description="Readings above are implausible and not used.")
    dark_correction: bool = Field(
        default=True, description="Learn each sensor's voltage in the dark at night and subtract it."
    )
    calibration_file: FilePath | None = Field(
        None,
        examples=["calibration.toml"],
        description="File that 'heliocube calibrate' writes; its gains and offsets replace those of the faces below.",
    )
    self_test_channel: Channel | None = Field(
        None,
        examples=[7],
        description="Multiplexer input that is short-circuited: read before each scan to test multiplexer and meter.",
    )
    second_self_test_channel: Channel | None = Field(
        None,
        examples=[4],
        description="Another short-circuited input, whose address has all lines inverted: only both inputs together"
        " detect every stuck line.",
    )
    self_test_limit_mv: Positive = Field(
        0.5, le=100, description="Largest voltage of a short-circuited input that passes the self-test."
    )
    east: FaceSettings = FaceSettings(channel=0)
    south: FaceSettings = FaceSettings(channel=1)
    west: FaceSettings = FaceSettings(channel=2)
    zenith: FaceSettings = FaceSettings(channel=3, tilt_deg=0.0)

    @field_validator("east", "south", "west", "zenith", mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Give a face of which the file sets only some keys the defaults of the same face for the others."""
        return with_defaults(cls, value, info)


class WindowSettings(Section):
    """The rhythm of control: the paper's mean over 120 s, every 300 s."""

    mean_s: Duration = Field(120.0, description="Span of the newest readings that a decision averages.")
    decide_every_s: Duration = Field(
        300.0, description="Time from one decision to the next; optimal decides every minute, whatever this is set to."
    )
    minimum_coverage: float = Field(
        0.25,
        gt=0,
        le=1,
        description="Share of the span that good readings must cover for a decision. With 0.25, the first scan of a"
        " cube that was away for 70 s is enough.",
    )


class LimitSettings(Section):
    """The permitted range of the angles: A -50 East to +50 West, B 90 flat. The mechanics allow no more than this."""

    a_min_deg: float = Field(-50.0, ge=-50, le=50, description="Lowest angle A, towards the east.")
    a_max_deg: float = Field(50.0, ge=-50, le=50, description="Highest angle A, towards the west.")
    b_min_deg: float = Field(15.0, ge=15, le=90, description="Lowest angle B, the steepest.")
    b_max_deg: float = Field(90.0, ge=15, le=90, description="Highest angle B; 90 is flat.")

    def limits(self) -> Limits:
        """Return the range as the science and the drivers know it."""
        return Limits(self.a_min_deg, self.a_max_deg, self.b_min_deg, self.b_max_deg)


class RowsSettings(Section):
    """The trackers that may shade each other, this one among them. Without positions no shade is considered.

    Every tracker of the group gets the same section: all are assumed to stand in one pose and to turn back together.
    """

    east_m: tuple[Place, ...] = Field(
        (),
        strict=False,
        max_length=1000,
        description="Distance east from one common point to the middle of each tracker's module, such as [0, 5, 10].",
    )
    north_m: tuple[Place, ...] = Field(
        (), strict=False, max_length=1000, description="Distance north from that point, in the same order."
    )
    up_m: tuple[Place, ...] = Field(
        (), strict=False, max_length=1000, description="Height above that point; empty if the ground is level."
    )
    module_width_m: Edge | None = Field(
        None, examples=[2.0], description="Edge of the module that lies east to west when it is flat."
    )
    module_height_m: Edge | None = Field(
        None, examples=[1.2], description="The other edge, north to south when it is flat."
    )
    bypass_groups: int = Field(
        3,
        ge=0,
        le=100,
        description="Groups of cells with a bypass diode each, side by side across the width: shade on any part"
        " of one takes all of its power. 0: only the shaded area is lost.",
    )
    turn_back: Literal["if-it-pays", "always"] = Field(
        "if-it-pays",
        description="When laws other than optimal backtrack to avoid shade: only where all trackers together get more"
        " beam that way, or always. Optimal weighs the shade itself.",
    )

    @property
    def positions_m(self) -> list[tuple[float, float, float]]:
        """East, north and up of each tracker [m], as far as the lists go together."""
        return list(zip(self.east_m, self.north_m, self.up_m or repeat(0.0), strict=False))

    def group(self, latitude_deg: float) -> TrackerGroup | None:
        """Return the group as the science knows it; None where there is none."""
        if not self.east_m or self.module_width_m is None or self.module_height_m is None:
            return None
        size_m = (self.module_width_m, self.module_height_m)
        pays = self.turn_back == "if-it-pays"
        return _group(self.east_m, self.north_m, self.up_m, size_m, latitude_deg, self.bypass_groups, pays)


@lru_cache(maxsize=8)
def _group(
    east_m: tuple[float, ...],
    north_m: tuple[float, ...],
    up_m: tuple[float, ...],
    size_m: tuple[float, float],
    latitude_deg: float,
    bypass_groups: int,
    only_if_it_pays: bool,
) -> TrackerGroup:
    """Build a group once for all its trackers: to build it for each of hundreds would take long."""
    return TrackerGroup.from_map(
        east_m, north_m, up_m, size_m, latitude_deg, bypass_groups, only_if_it_pays=only_if_it_pays
    )


class MotionSettings(Section):
    """When a move is worth it, and what counts as having arrived."""

    deadband_deg: NotNegative = Field(0.6, le=30, description="A smaller change of direction is not worth a move.")
    minimum_interval_s: NotNegative = Field(
        60.0, le=86400, description="Least time from the start of a move of any kind to the next tracking move."
    )
    tolerance_deg: Positive = Field(0.8, le=10, description="Distance from the target that counts as arrived.")
    travel_per_day_deg: Positive = Field(
        2000.0,
        le=100000,
        description="Degrees of travel in a solar day, A and B added, beyond which no law moves the tracker.",
    )
    moves_per_day: int = Field(
        300,
        ge=1,
        le=10000,
        description="Moves in a solar day beyond which no law moves the tracker; they are spread to last until sunset.",
    )
    attempts: int = Field(3, ge=1, le=10, description="Attempts before a move is given up and reported as a fault.")
    retry_after_s: Duration = Field(600.0, description="Time after a fault until moves are tried again.")
    rehome: Literal["operator", "automatic"] = Field(
        "operator", description="Who orders the reference run after the positioner has lost its reference."
    )


class SafetySettings(Section):
    """When not to track."""

    scan_stale_s: Duration = Field(15.0, description="Age beyond which the newest scan is no longer used.")
    fallback_after_s: Duration = Field(60.0, description="Time without good readings after which the mode is fallback.")
    keep_pose_s: NotNegative = Field(
        300.0,
        le=900,
        description="How long a tracker in fallback keeps its pose after the last good readings, before it follows "
        "the sun by ephemeris: a short gap is not worth a move to the sun and back.",
    )
    night_below_w_m2: NotNegative = Field(5.0, le=200, description="Zenith irradiance below which night begins.")
    night_above_w_m2: NotNegative = Field(10.0, le=200, description="Zenith irradiance above which night ends.")
    night_highest_sun_deg: float = Field(
        5.0, ge=-5, le=30, description="With the sun higher than this it is never night, however dark."
    )
    night_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A at night.")
    night_b_deg: float = Field(90.0, ge=15, le=90, description="Angle B at night.")
    stow_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A of the stow position.")
    stow_b_deg: float = Field(90.0, ge=15, le=90, description="Angle B of the stow position.")
    snow_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A of the snow position.")
    snow_b_deg: float = Field(
        15.0,
        ge=15,
        le=90,
        description="Angle B of the snow position: steep sheds snow and hail. The default is cut to the limits.",
    )
    stow_wind_m_s: WindSpeed = Field(15.0, description="Wind speed from which the tracker is stowed.")
    release_wind_m_s: WindSpeed = Field(10.0, description="Wind speed below which stow may end.")
    stow_at_least_s: Duration = Field(900.0, description="How long the wind must have been calm before stow ends.")
    wind_stale_s: Duration = Field(300.0, description="Silence of the wind sensor that counts as strong wind.")
    without_wind_source: Literal["alarm", "accepted"] = Field(
        "alarm",
        description="What to do on real instruments when nothing reports the wind: alarm, or accepted if storms"
        " are handled by other means.",
    )


class Sections(Section):
    """Everything that a file may set, section by section."""

    site: SiteSettings = SiteSettings()
    cube: CubeSettings = CubeSettings()
    instruments: Instruments = Field(default_factory=Instruments)
    load: Annotated[SerializeAsAny[LoadSettings], BeforeValidator(LOAD.validate)] = Field(default_factory=LOAD.defaults)
    law: Annotated[SerializeAsAny[LawSettings], BeforeValidator(LAW.validate)] = Field(default_factory=LAW.defaults)
    windows: WindowSettings = WindowSettings()
    limits: LimitSettings = LimitSettings()
    rows: RowsSettings = RowsSettings()
    motion: MotionSettings = MotionSettings()
    safety: SafetySettings = SafetySettings()
    bridge: BridgeSettings = BridgeSettings()
    store: StoreSettings = StoreSettings()
    api: ApiSettings = ApiSettings()
    dashboard: DashboardSettings = DashboardSettings()
    notify: NotifySettings = NotifySettings()
    archive: ArchiveSettings = ArchiveSettings()
    sunspec: SunspecSettings = SunspecSettings()
    mqtt: MqttSettings = MqttSettings()
    simulation: SimulationSettings = SimulationSettings()
