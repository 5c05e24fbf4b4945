"""Answers: for scripts as JSON alone on standard output, for people in lines that a terminal has room for."""

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

    Dataclasses become objects, arrays lists, times and paths text; a number that is none becomes null. ASCII, because
    standard output may have any encoding.
    """
    import json

    from pydantic_core import to_jsonable_python

    # By way of Python, since a path may hold bytes that are no UTF-8.
    plain = to_jsonable_python(page, inf_nan_mode="null", fallback=lambda value: value.tolist())
    typer.echo(json.dumps(plain, indent=2))


def teller(*, as_json: bool) -> Callable[[str], None]:
    """Return what takes a line for people: to standard output, or to standard error where JSON has that for itself."""
    return lambda text: say(text, err=as_json)


@contextmanager
def goes_on_later(so_far: str) -> Iterator[None]:
    """Say where Ctrl-C ends a work what of it stays, since it goes on where it was; raises `InterruptedEarlyError`."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedEarlyError(f"interrupted: {so_far}; give the command again for the rest") from None


def say(text: str, *, err: bool = False, hang: int = 2, end: str = "\n") -> None:
    """Print text for people, to standard error if `err`, and `end` after it; `hang` as of `wrapped`."""
    typer.echo(wrapped(text, sys.stderr if err else sys.stdout, hang=hang) + end, err=err, nl=False)


def warn(text: str) -> None:
    """Tell a warning of a result on standard error."""
    say(f"heliocube: warning: {text}", err=True)
