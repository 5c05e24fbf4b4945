"""What the tables of the configuration file have in common."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema


def _no_empty_path(value: object) -> object:
    if value == "":
        raise ValueError("empty")
    return value


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Duration = Annotated[float, Field(gt=0, le=86400)]
FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_no_empty_path)]


class Section(BaseModel):
    """A table of the file: frozen, closed to keys it does not know, and with no guessing of types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)


def text_of(form: str) -> WithJsonSchema:
    """Return the schema of a text of one of the forms that `daemon.config.keys` has words for."""
    return WithJsonSchema({"type": "string", "format": form})


def with_defaults(section: type[Section], value: Any, info: ValidationInfo) -> Any:
    """Give an inner table of which the file names some keys the outer table's defaults for the others."""
    if not isinstance(value, dict) or info.field_name is None:
        return value
    return {**section.model_fields[info.field_name].default.model_dump(), **value}
