"""Answers for scripts: what a command has found, as JSON alone on standard output."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import typer
from rich.console import Console

JsonOption = Annotated[
    bool, typer.Option("--json", help="The answer as JSON, alone on standard output; all else goes to standard error.")
]


def print_json(page: Mapping[str, Any] | list[Any]) -> None:
    """Print a page as JSON.

    Dataclasses become objects, arrays lists, times and paths text; a number that is none becomes null. ASCII, because
    standard output may have any encoding.
    """
    from pydantic_core import to_json

    text = to_json(page, indent=2, ensure_ascii=True, inf_nan_mode="null", fallback=lambda value: value.tolist())
    typer.echo(text.decode("ascii"))


def teller(*, as_json: bool) -> Callable[[str], None]:
    """Return what takes a line for people: to standard output, or to standard error where JSON has that for itself."""
    console = Console(stderr=as_json, highlight=False, soft_wrap=True)
    return lambda text: console.print(text, markup=False)
