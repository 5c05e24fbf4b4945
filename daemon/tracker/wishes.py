"""What persons have asked for and not yet released, kept over a restart.

A service that is killed in a storm or under repair and comes back must not go to work by itself.
"""

import logging
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from daemon.base.clock import LEAST_SHOWN_UTC_S, MOST_SHOWN_UTC_S, iso_utc
from daemon.base.state import StateFile, StateFolder, UnreadableStateError

log = logging.getLogger("heliocube.control")

FILE_NAME = "operator.json"
PROGRAM = "heliocube"
"""`by` of a hold that the service itself has set, after another release or another name of a tracker."""

# Many programs give the time of a command in whole seconds.
_WHOLE_SECONDS_S = 1.0

# Kept beside the first wish. If there are more, the newest replaces the last, so that a flood cannot fill the file.
_MOST_LATER_REQUESTS = 8

# What each wish does to the tracker, as the beginning of a sentence.
_EFFECT_WORDS = {
    "maintenance": "in maintenance",
    "stop": "stopped",
    "buttons": "held",
    "stow": "stowed",
    "snow": "in the snow position",
    "hold": "held",
}


class Wish(BaseModel):
    """One wish of a person, or of the service itself.

    Attributes
    ----------
    why, by
        The reason and the person, each one line; `by` is empty if no name was given.
    since_utc_s
        When it was asked for first; None if that is not known.
    goto_deg
        A and B [deg] of the position, if the hold comes from a goto; None for all other wishes.
    again_utc_s
        When it was asked for last; None if it was asked for only once.
    also
        Later requests for the same, by other persons or with other reasons; None if there are none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    why: str
    by: str = ""
    since_utc_s: float | None = Field(default=None, allow_inf_nan=False, ge=LEAST_SHOWN_UTC_S, le=MOST_SHOWN_UTC_S)
    goto_deg: tuple[FiniteFloat, FiniteFloat] | None = Field(default=None, strict=False)
    again_utc_s: float | None = Field(default=None, allow_inf_nan=False, ge=LEAST_SHOWN_UTC_S, le=MOST_SHOWN_UTC_S)
    also: tuple["Wish", ...] | None = Field(default=None, strict=False)

    @property
    def first(self) -> "Wish":
        """The first request, without those that joined it."""
        return self.model_copy(update={"again_utc_s": None, "also": None})

    @property
    def all_requests(self) -> tuple["Wish", ...]:
        """The wish and the later requests for the same, the first in front."""
        return (self, *(self.also or ()))

    def has_request(self, why: str, by: str) -> bool:
        """Whether this person has asked for it with this reason."""
        return any((each.why, each.by) == (why, by) for each in self.all_requests)

    def joined_by(self, later: "Wish") -> "Wish":
        """Return this wish with a later one beside it: like padlocks on one switch, the first stays."""
        also = self.also or ()
        if not self.has_request(later.why, later.by):
            also = (*also[: _MOST_LATER_REQUESTS - 1], later)
        return self.model_copy(update={"again_utc_s": later.since_utc_s, "also": also or None})

    @property
    def latest_utc_s(self) -> float | None:
        """When it was asked for last; None where that is not known."""
        return self.since_utc_s if self.again_utc_s is None else self.again_utc_s

    @property
    def latest(self) -> str | None:
        """`latest_utc_s` as the state shows it."""
        return None if self.latest_utc_s is None else iso_utc(self.latest_utc_s)

    @property
    def since(self) -> str | None:
        """When it was asked for first, as the state shows it; None where that is not known."""
        return None if self.since_utc_s is None else iso_utc(self.since_utc_s)

    @property
    def origin_text(self) -> str:
        """By whom and since when, in words; empty where neither is known."""
        by = f" by {self.by}" if self.by else ""
        return by if self.since_utc_s is None else f"{by} since {_stamp(self.since_utc_s)}"


def _from_text(value: Any) -> Any:
    """Accept the form of earlier versions, which kept only the reason."""
    return {"why": value} if isinstance(value, str) else value


OptionalWish = Annotated[Wish | None, BeforeValidator(_from_text)]


class Wishes(BaseModel):
    """The wishes in force, None for each that nobody has. `buttons`: a person has pressed a button at the unit."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    maintenance: OptionalWish = None
    stop: OptionalWish = None
    buttons: OptionalWish = None
    stow: OptionalWish = None
    snow: OptionalWish = None
    hold: OptionalWish = None

    def describe(self, name: str) -> str | None:
        """Return one wish in words, such as ``stopped by ana@lab since 2022-10-12 10:00:03 UTC: repair``, or None."""
        wish: Wish | None = getattr(self, name)
        if wish is None:
            return None
        return _EFFECT_WORDS[name] + "; also".join(f"{each.origin_text}: {each.why}" for each in wish.all_requests)

    @property
    def standstill_reason(self) -> str | None:
        """Why nothing at all may move, or None: the first of maintenance, a person's stop, a person at the buttons."""
        if self.maintenance is None and self.stop is None and self.buttons is None:
            return None
        return self.describe("maintenance") or self.describe("stop") or self.describe("buttons")

    @property
    def allow_rehoming(self) -> bool:
        """Whether a reference run, which tilts the module, may start by itself: not while any wish is in force."""
        return not any(getattr(self, name) for name in type(self).model_fields)

    @property
    def held_by_program(self) -> str | None:
        """Return why the service itself holds the tracker until a person has looked, in words, or None."""
        return self.describe("hold") if self.hold is not None and self.hold.by == PROGRAM else None

    def describe_newer_than(self, utc_s: float) -> str | None:
        """Return in words a wish that was made after an instant [s of UTC] and is in force, or None."""
        for name in type(self).model_fields:
            wish: Wish | None = getattr(self, name)
            if wish is not None and wish.latest_utc_s is not None and wish.latest_utc_s > utc_s + _WHOLE_SECONDS_S:
                return self.describe(name)
        return None

    def describe_unshown(self, shown: Mapping[str, str | None]) -> str | None:
        """Return in words a wish in force that was not shown, or was shown with another time, or None.

        Times are compared for equality: after a clock was set back, "later than" would hide new wishes for hours, or
        forbid to end them.
        """
        for name in type(self).model_fields:
            wish: Wish | None = getattr(self, name)
            if wish is not None and (name not in shown or shown[name] != wish.latest):
                return self.describe(name)
        return None

    def describe_ended(self, later: "Wishes") -> Iterator[str]:
        """Yield in words each wish that stands here and has ended or been replaced in `later`."""
        for name in type(self).model_fields:
            text, after = self.describe(name), getattr(later, name)
            # A wish that another one has joined still stands.
            if text is not None and (after is None or after.first != getattr(self, name).first):
                yield text

    def replaced_note(self, now: "Wishes", said: str) -> str:
        """Return the end of an answer to a command: which wishes it replaced, or beside which stop it was noted.

        Empty for neither, and for a stop that the answer so far, `said`, already tells.
        """
        if self.stop is not None and now.stop is not None:
            stands = self.describe("stop") or ""
            return "" if stands in said or now.stop.also == self.stop.also else f"; also in force: {stands}"
        ended = "; ".join(self.describe_ended(now))
        return f"; this replaces: {ended}" if ended else ""


def kept_wishes(folder: StateFolder) -> Wishes:
    """Return the wishes kept in a folder that no service is using; nothing is written there."""
    return _load(_file_in(folder))


class WishFile:
    """Wishes in a small file beside the store; in a folder without a directory they live in memory only.

    Parameters
    ----------
    folder
        Folder of the file.
    """

    def __init__(self, folder: StateFolder) -> None:
        self._file = _file_in(folder)
        self._file.reserve()

    def load(self) -> Wishes:
        """Return what was wished before the restart; a file that cannot be read counts as a stop."""
        return _load(self._file)

    def save(self, wishes: Wishes) -> None:
        """Have the file replaced as a whole; a slow or failing disk does not hold up the command."""
        self._file.save(wishes)


def _file_in(folder: StateFolder) -> StateFile[Wishes]:
    return StateFile(folder, FILE_NAME, Wishes, log, "what was asked")


def _load(file: StateFile[Wishes]) -> Wishes:
    try:
        return file.load() or Wishes()
    except UnreadableStateError as error:
        log.warning("%s: the tracker stays stopped until 'heliocube auto'", error)
        return Wishes(stop=Wish(why=f"{error}: it is not known which commands were in force before the restart"))


def _stamp(utc_s: float) -> str:
    return iso_utc(utc_s)[:19].replace("T", " ") + " UTC"
