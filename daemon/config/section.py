"""What every table of the configuration file has in common."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, WithJsonSchema

Positive = Annotated[float, Field(gt=0)]


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
