"""The bodies of commands: the models that check them, over HTTP and over MQTT, and that describe them to programs."""

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
)

ModeName = Literal["auto", "hold", "stow", "snow", "maintenance"]
MODES: tuple[str, ...] = get_args(ModeName)

DEFAULT_REASON = "an operator asked"

_LONGEST_LINE = 200
# What str.isprintable() lets pass: letters, marks, numbers, punctuation, symbols and the space of ASCII.
_PRINTABLE = r"^[\p{L}\p{M}\p{N}\p{P}\p{S} ]+$"


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("not one line")
    return text


def _one_line(value: object) -> str:
    """Return a text as one line that is not too long; empty for anything but text."""
    text = value if isinstance(value, str) else ""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:_LONGEST_LINE]


def _degrees(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("not a number")  # noqa: TRY004 - pydantic takes no TypeError from a validator
    try:
        return float(value)
    except OverflowError:
        # An integer that no float can hold: the limits refuse it.
        return math.inf


Line = Annotated[
    str,
    StringConstraints(min_length=1, max_length=_LONGEST_LINE),
    AfterValidator(_printable),
    WithJsonSchema({"type": "string", "minLength": 1, "maxLength": _LONGEST_LINE, "pattern": _PRINTABLE}),
]
# A stop is never refused for its words.
LenientLine = Annotated[str, BeforeValidator(_one_line), WithJsonSchema({})]
Degrees = Annotated[float, BeforeValidator(_degrees), WithJsonSchema({"type": "number"})]


_LINE: TypeAdapter[str] = TypeAdapter(Line)


class CommandBody(BaseModel):
    """What may come with every command; each key may be left out."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    why: LenientLine = Field(
        DEFAULT_REASON,
        description=f"The reason, a text for the records: kept as one line, cut to {_LONGEST_LINE} letters; anything"
        " but text counts as left out.",
    )
    by: LenientLine = Field(
        default_factory=str,
        description="Who asks, kept in the same way; if left out or empty, the way over which the command came.",
    )
    id: Line = Field(default_factory=str, description="Is repeated in the answer.")
    tracker: Line = Field(default_factory=str, description="Which tracker is meant, where there are several.")


class GotoBody(CommandBody):
    """What comes with goto."""

    a_deg: Degrees = Field(description="Where to: axis A, in degrees.")
    b_deg: Degrees = Field(description="Where to: axis B, in degrees.")


class AutoBody(CommandBody):
    """What comes with auto."""

    shown: dict[str, str | None] | None = Field(
        None,
        description="By name, the `latest` of each wish in the `wishes` of the state that the caller was shown: if"
        " anything else has been asked for since, nothing is ended.",
    )


class ModeBody(CommandBody):
    """What comes with mode."""

    mode: ModeName = Field(description="What is asked for, as by the command of that name.")


class AcknowledgeBody(CommandBody):
    """What comes with acknowledge."""

    alarm: Line = Field(default_factory=str, description="The alarm's name; if left out, all that are shown.")


def body_model(name: str) -> type[CommandBody]:
    """Return the model of a command's body."""
    if name == "goto":
        return GotoBody
    if name == "acknowledge":
        return AcknowledgeBody
    if name == "auto":
        return AutoBody
    return ModeBody if name == "mode" else CommandBody


def validate_body(name: str, found: dict[str, Any], more: tuple[str, ...] = ()) -> CommandBody:
    """Return the body of a command; raises `ValueError` with one sentence for one that is not understood.

    A stop is never refused for its body: keys that are not understood count as left out.

    Parameters
    ----------
    name, found
        The command, and the object that came with it.
    more
        Further keys, each with a line of text, that commands may have on this way, such as ``time`` over a broker.
    """
    model = body_model(name)
    own = {key: value for key, value in found.items() if key not in more}
    wrong = {}
    try:
        body = model.model_validate(own)
    except ValidationError as error:
        wrong = {str(item["loc"][0]): item["type"] for item in error.errors(include_url=False)}
    for key in more:
        try:
            _LINE.validate_python(found.get(key, "-"), strict=True)
        except ValidationError:
            wrong[key] = "line"
    if not wrong:
        return body
    if name == "stop":
        return model.model_validate({key: value for key, value in own.items() if key not in wrong})
    lines = (*CommandBody.model_fields, *more)
    for key, kind in wrong.items():
        if kind == "extra_forbidden":
            known = ", ".join([*(key for key in model.model_fields if key not in lines), *lines])
            raise ValueError(f"the body has {ascii(key)[:40]}, but may have only {known}")
    for key in (*lines, "alarm"):
        if key in wrong:
            raise ValueError(f'"{key}" must be one line of text with at most {_LONGEST_LINE} letters')
    if "shown" in wrong:
        raise ValueError('"shown" must have the time of each wish, such as {"stop": "2026-06-21T10:00:00.000Z"}')
    if model is ModeBody:
        stop = "; for a stop, use the command stop" if "stop" in str(own.get("mode")).lower() else ""
        raise ValueError(f"the mode must be one of {', '.join(MODES)}{stop}")
    raise ValueError('goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}')
