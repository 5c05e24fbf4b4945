"""Commands to a running bench; apart from the simulators, so that a command does not wait for them to load."""

from pathlib import Path
from typing import Any

from daemon.base.errors import UserError
from sim_drivers.bench.client import BenchError, request


def ask_bench(directory: Path, verb: str, arguments: list[str]) -> Any:
    """Send a command to the bench in a directory and return its answer; raises `UserError`."""
    try:
        return request(directory, verb, arguments)
    except BenchError as error:
        raise UserError(str(error)) from error


def bench_verbs() -> dict[str, tuple[str, str]]:
    """Return the bench's commands by name: what each takes, and what it does."""
    from sim_drivers.bench.verbs import VERBS  # noqa: PLC0415 - they name the faults of the simulators, which load slowly

    return {name: (verb.usage, verb.meaning) for name, verb in VERBS.items()}
