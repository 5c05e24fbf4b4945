"""Answers: for scripts as JSON alone on standard output, for people in lines that fit a terminal."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from daemon.base.errors import InterruptedEarlyError
from daemon.commands.wrapping import wrapped

JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print only the answer, as JSON, on standard output; the rest goes to standard error."),
]


def print_json(page: Mapping[str, Any] | list[Any]) -> None:
    """Print a page as JSON.

    Dataclasses become objects, arrays lists, times and paths text; NaN and infinity become null. The output is ASCII,
    because standard output may have any encoding.
    """
    import json

    from pydantic_core import to_jsonable_python

    # json.dumps writes the text and not pydantic, since a path may hold bytes that are not UTF-8.
    plain = to_jsonable_python(page, inf_nan_mode="null", fallback=lambda value: value.tolist())
    typer.echo(json.dumps(plain, indent=2))


def message_printer(*, as_json: bool) -> Callable[[str], None]:
    """Return a function that prints a line for people: on standard output, or on standard error beside JSON."""
    return lambda text: say(text, err=as_json)


@contextmanager
def explain_interruption(so_far: str) -> Iterator[None]:
    """Say after Ctrl-C what is done so far: the work can be taken up there. Raises `InterruptedEarlyError`."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedEarlyError(f"interrupted: {so_far}; give the command again for the rest") from None


def say(text: str, *, err: bool = False, hang: int = 2, end: str = "\n") -> None:
    """Print text for people, to standard error if `err`, and `end` after it; `hang` as for `wrapped`."""
    typer.echo(wrapped(text, sys.stderr if err else sys.stdout, hang=hang) + end, err=err, nl=False)


def warn(text: str) -> None:
    """Print a warning about a result on standard error."""
    say(f"heliocube: warning: {text}", err=True)
