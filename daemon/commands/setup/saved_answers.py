"""The answers so far, kept beside the future configuration, so that a person may leave and come back."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from daemon.base.errors import UserError
from daemon.base.files import replace_file

Answer = str | float | int | bool | list[str] | list[int] | None
_LONGEST_FILE = 65536


class SetupAnswers(BaseModel):
    """The answers by the name of their step, in the order of asking.

    Attributes
    ----------
    answers
        The answers that are settled.
    offered
        Also the answers that were settled before a person went back: at these steps Enter takes them again.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    form: Literal[1] = 1
    answers: dict[str, Answer] = {}
    offered: dict[str, Answer] = {}


def answers_path(file: Path) -> Path:
    """Return where the answers for a configuration are kept: ``tracker.setup.json`` for ``tracker.toml``."""
    return file.with_name(f"{file.stem}.setup.json")


def load_answers(place: Path) -> SetupAnswers:
    """Return the answers that are kept, none if there is no such file; raises `UserError` if it cannot be used."""
    try:
        if place.exists() and not (place.is_file() or place.is_dir()):
            # To open a pipe would wait for a writer.
            raise UserError(f"{place} is no ordinary file, but a device or a pipe: remove it, or begin with --anew")
        with place.open("rb") as file:
            return SetupAnswers.model_validate_json(file.read(_LONGEST_FILE))
    except (FileNotFoundError, NotADirectoryError):
        return SetupAnswers()
    except OSError as error:
        raise UserError(f"{place} cannot be read: {error.strerror}") from None
    except ValidationError:
        raise UserError(f"{place} does not hold the answers of a setup: remove it, or begin with --anew") from None


def keep_answers(place: Path, kept: SetupAnswers) -> None:
    """Replace the answers that are kept; raises `UserError` if they cannot be written."""
    try:
        replace_file(place, kept.model_dump_json(indent=1) + "\n")
    except OSError as error:
        raise UserError(
            f"{place} cannot be written ({error.strerror}), nor could the configuration beside it: name a file in"
            " a folder of yours, or run this as the user who owns this folder"
        ) from None
