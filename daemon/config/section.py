"""What the tables of the configuration file have in common."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _no_empty_path(value: object) -> object:
    if value == "":
        raise ValueError("empty")
    return value


NotNegative = Annotated[float, Field(ge=0)]
Duration = Annotated[float, Field(gt=0, le=86400)]
FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_no_empty_path)]


class Section(BaseModel):
    """A table of the file: frozen, closed to keys it does not know, and with no guessing of types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)
