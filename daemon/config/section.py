"""What the tables of the configuration file have in common."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from daemon.base.errors import UserError
from daemon.base.files import parse_toml, toml_text

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


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


Kind = TypeVar("Kind", bound=Section)


def read_tables(path: Path | None) -> dict[str, Any]:
    """Return the tables of a file, none for None; raises `UserError`."""
    if path is None:
        return {}
    try:
        return parse_toml(toml_text(path))
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{path} is not TOML: {error}; see 'heliocube config check {path}'") from None


def validate_section(path: Path | None, raw: dict[str, Any], name: str, kind: type[Kind]) -> Kind:
    """Return one section of a file, whatever else is wrong in it; raises `UserError`."""
    try:
        return kind.model_validate(raw.get(name, {}))
    except ValidationError:
        raise UserError(f"the [{name}] of {path} is wrong; see 'heliocube config check {path}'") from None


_CLAUSES = {
    "missing": "is missing",
    "extra_forbidden": "is not known here",
    "float_parsing": "{input!r} is not a number",
    "float_type": "{input!r} is not a number",
    "finite_number": "{input!r} is not a finite number",
    "int_parsing": "{input!r} is not a whole number",
    "int_from_float": "{input!r} is not a whole number",
    "greater_than_equal": "{input!r} is not a number from {ge} up",
    "greater_than": "{input!r} is not a number above {gt}",
    "less_than_equal": "{input!r} is not a number up to {le}",
    "less_than": "{input!r} is not a number below {lt}",
}


def describe_error(wrong: "ErrorDetails") -> str:
    """Return in a clause, for people, what is wrong with a value that a model has refused."""
    clause = _CLAUSES.get(wrong["type"])
    if clause is None:
        return wrong["msg"].removeprefix("Value error, ")
    # A bound that is a whole number is told with all its digits: rounded up, it would be out of bounds itself.
    told = wrong.get("ctx", {}).items()
    bounds = {name: f"{value:.10g}" if isinstance(value, float) else value for name, value in told}
    return clause.format(input=wrong["input"], **bounds)


def resolve_file_paths(path: Path | None, section: Kind) -> Kind:
    """Return a section with the paths of its files completed: relative ones start from the configuration's folder.

    Raises
    ------
    UserError
        A path names the home of a user who does not exist.
    """
    folder = Path() if path is None else path.parent
    files = {}
    for name, value in section:
        if isinstance(value, Path):
            try:
                files[name] = folder / expand_home(value)
            except ValueError as error:
                raise UserError(f"{name} = {str(value)!a}: {error}") from None
    return section.model_copy(update=files)


def expand_home(path: Path) -> Path:
    """Return a path with the home that its ~ means; raises `ValueError` where nobody has that name."""
    try:
        return path.expanduser()
    except RuntimeError:
        raise ValueError("there is no such user; write the whole path") from None


def resolve_path(folder: Path, path: Path) -> Path:
    """Return the whole path of one that starts from a folder, links followed; raises `ValueError` if there is none."""
    meant = folder / expand_home(path)
    try:
        whole = meant.resolve()
    except (RuntimeError, OSError):
        whole = None
    # From Python 3.13 on `resolve` raises nothing for a link that leads back to itself, and returns it as it is.
    if whole is None or os.path.islink(whole):  # noqa: PTH114 - what may not be looked into is no link
        raise ValueError(f"{meant} is a link that leads back to itself; remove it, or name another")
    return whole
