"""What the local interface answers, as models: they describe it to programs, and tests hold the answers to them."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from daemon.base.records import Scan
from daemon.store.tables import COLUMNS, Column

UtcText = Annotated[
    str, Field(pattern=r"^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}\.\d{3}Z$", description="A time in UTC, ISO 8601.")
]
NonNegativeInt = Annotated[int, Field(ge=0)]


class Page(BaseModel):
    """An answer in JSON: every key is there, and no other."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ErrorPage(Page):
    """What cannot be done, and what to do about it."""

    error: str = Field(
        description="One sentence; for several trackers at once, a line for each, those that failed first.",
        min_length=1,
    )


class CommandPage(Page):
    """What came of a command."""

    command: str
    id: str | None = Field(description="The id that came with the command.")
    accepted: Literal[True]
    done: bool = Field(description="Whether telemetry has shown the whole effect of the command.")
    state: Literal["done", "under-way", "not-seen"]
    text: str = Field(
        description="What the tracker did, in a sentence; for several, a line for each, those that failed first."
    )


class HealthPage(Page):
    """Whether the work goes on."""

    ok: bool
    troubles: list[str] = Field(description="What no longer works; empty if `ok`.")
    down: list[str] = Field(description="Devices and links that do not work; they are no reason for a restart.")
    loop_late_worst_s: float = Field(description="How late the event loop was at most in the last minute or two.")
    simulated: bool


class SunPointPart(Page):
    """Where the sun is at an instant."""

    time: UtcText
    azimuth_deg: float = Field(description="From north, clockwise.")
    elevation_deg: float = Field(description="Apparent.")


class SunPage(Page):
    """A solar day."""

    sunrise: UtcText | None = Field(description="Null on a day without sunrise.")
    noon: UtcText
    sunset: UtcText | None
    highest_elevation_deg: float
    path: list[SunPointPart]


class DaysPage(Page):
    """The solar days that have records."""

    days: list[str] = Field(
        description="Such as 2022-10-14, the oldest first; from midnight to midnight by the mean sun at the site."
    )


class LinesPage(Page):
    """Stored records that say something in words."""

    rows: list[dict[str, Any]] = Field(description="Each has the columns of the kind's table; the oldest is first.")
    more: bool = Field(description="Whether the span has later records.")


class AuthorisedPage(Page):
    """The token is the service's."""

    ok: Literal[True]


class AlarmPart(Page):
    """An alarm that is on, or that is over and waits for a person to look."""

    name: str = Field(description="The name of its kind; docs/alarms.md lists them.")
    severity: Literal["critical", "warning", "notice"]
    state: Literal["raised", "acknowledged", "cleared"] = Field(
        description="`cleared`: its cause has ended, and nobody has acknowledged it."
    )
    text: str = Field(description="What is wrong now, in a sentence.")
    cause: str
    effect: str
    remedy: str
    latched: bool = Field(description="Whether it stays after its cause has ended, until a person acknowledges it.")
    since: UtcText = Field(description="The same as `raised_at`.")
    raised_at: UtcText
    acknowledged_at: UtcText | None
    acknowledged_by: str | None
    cleared_at: UtcText | None
    tracker: str | None


class NewsPart(Page):
    """What happened."""

    time: UtcText
    text: str


class ModePart(Page):
    """A tracker's mode."""

    name: str
    why: str
    since: UtcText
    asked: Literal["maintenance", "stop", "buttons", "stow", "snow", "hold"] | None = Field(
        description="The wish of a person that causes the mode; in the mode hold it tells a stop from a hold."
    )


class FacePart(Page):
    """A face of the newest scan."""

    irradiance_w_m2: float | None
    quality: str
    age_s: float | None


class NewestScanPart(Page):
    """The newest scan."""

    source: str
    session: str
    sequence: NonNegativeInt
    time: UtcText
    age_s: float | None
    stale: bool
    simulated: bool
    calibration: str | None
    faces: dict[str, FacePart]


class SitePart(Page):
    """Where the tracker stands."""

    name: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class BridgePart(Page):
    """Counts of the bridge's receiver, and why it hears nothing."""

    accepted: NonNegativeInt
    lost: NonNegativeInt
    refused: NonNegativeInt
    down_why: str | None


class StorePart(Page):
    """How the store is."""

    path: str
    written: NonNegativeInt
    waiting: NonNegativeInt
    lost: NonNegativeInt
    down_why: str | None


class LoopPart(Page):
    """How late the event loop was."""

    late_worst_s: float = Field(description="How late it was at most in the last minute or two.")


class NextPart(Page):
    """What the next decision would be, were the light to stay as it is."""

    time: UtcText = Field(description="When the decision is due.")
    law: str
    target_a_deg: float | None
    target_b_deg: float | None
    moves: bool = Field(description="Whether the target is worth a move; if not, the tracker stays where it stands.")
    why: str = Field(description="The reason, in words.")


class ReceivedPart(Page):
    """What three planes have received on this solar day, by the light that the faces show: a model's result."""

    since: UtcText = Field(description="The first instant that is counted.")
    known_s: float = Field(
        description="The time that is counted: the sun is up, the pose is known, and three faces are good.", ge=0
    )
    actual_kwh_m2: float = Field(description="Energy on the module's plane.", ge=0)
    chronometric_kwh_m2: float = Field(
        description="Energy on the plane of a tracker that always points at the sun.", ge=0
    )
    best_kwh_m2: float = Field(description="The most that any pose within the limits receives.", ge=0)
    gain: float | None = Field(
        description="How much more `actual_kwh_m2` is than `chronometric_kwh_m2`, as a share of the latter."
    )


class ShadowPart(Page):
    """The law of `law.shadow` today: what it would have received, and how far both laws have travelled."""

    law: str
    failed_why: str | None = Field(description="Why the law has failed; it is left out until the service restarts.")
    received: ReceivedPart | None = Field(description="What the plane would have received if this law had pointed it.")
    gain: float | None = Field(
        description="How much more than the tracker, as a share; null until both have counted the same time."
    )
    travelled_deg: float = Field(ge=0)
    moves: NonNegativeInt
    active_travelled_deg: float = Field(
        description="Travel by the laws that point the tracker, over the same time.", ge=0
    )
    active_moves: NonNegativeInt


class TrackerPart(Page):
    """A tracker, or, at the top, the only one; all null where there are several or none."""

    mode: ModePart | None
    wishes: dict[str, Any] | None = Field(
        description="What persons asked for: each wish has `why`, `by`, `since`, `latest` and `also`, or is null."
    )
    at_stow: bool | None = Field(
        description="Whether it was seen to stand at the stow position, with nothing in doubt, in whatever mode."
    )
    today: dict[str, Any] | None
    received: ReceivedPart | None = Field(description="Null before the first minute of the day that is counted.")
    shadow: ShadowPart | None = Field(description="Null without `law.shadow`.")
    irradiances: dict[str, Any] | None
    decision: dict[str, Any] | None
    law: dict[str, Any] | None
    next_decision_s: float | None
    next_decision: NextPart | None = Field(description="Null in modes that do not decide.")
    tracker: dict[str, Any] | None = Field(description="The positioner, its limits and its name.")
    load: dict[str, Any] | None
    wind: list[dict[str, Any]] | None = Field(description="Each source of stow: thresholds, speed, time to release.")
    wind_m_s: float | None = Field(description="The strongest of the last wind readings of the sources.")
    stow_release_in_s: float | None = Field(
        description="How long the calm must still last until no source asks for stow."
    )
    mqtt: dict[str, Any] | None


class StatePage(TrackerPart):
    """Everything there is to see."""

    version: str
    simulated: bool
    speed: float
    role: Literal["both", "cube", "tracker"]
    time: UtcText
    site: SitePart
    sun_elevation_deg: float | None
    sky: str | None
    scan: NewestScanPart | None
    calibration: dict[str, Any] | None
    cube_down_why: str | None
    unacknowledged: NonNegativeInt = Field(description="How many of the alarms nobody has acknowledged.")
    alarms: list[AlarmPart]
    bridge: BridgePart | None
    store: StorePart | None
    loop: LoopPart
    news: list[NewsPart]
    trackers: dict[str, TrackerPart]


_TYPES: dict[str, Any] = {"time": UtcText, "float": float | None, "int": int, "bool": bool, "text": str | None}


def _columns(columns: list[Column]) -> dict[str, Any]:
    return {column.name: (_TYPES[column.holds], ...) for column in columns if column.name != "time_monotonic_s"}


ScanPart = create_model("ScanPart", __base__=Page, __doc__="One scan.", **_columns(COLUMNS[Scan][1]))


class ScansPage(Page):
    """The oldest scans that ended later than asked for."""

    scans: Annotated[list[ScanPart], Field(max_length=500)]
    more: bool = Field(description="Whether there are more scans.")
