"""Where the program begins: straight to the service for what cannot wait, to the command line for all else."""

import sys
from pathlib import Path

from daemon.errors import UserError

_URGENT = ("stop", "stow")


def main() -> None:
    """Carry out `heliocube stop` and `heliocube stow` before any large library is loaded, and the rest as usual."""
    match sys.argv[1:]:
        case [command] if command in _URGENT:
            _at_once(command, None)
        case [command, "--config" | "-c", config] if command in _URGENT:
            _at_once(command, Path(config))
        case _:
            from daemon.cli import main as command_line  # noqa: PLC0415 - the large libraries

            command_line()


def _at_once(command: str, config: Path | None) -> None:
    from daemon.api.client import find  # noqa: PLC0415 - not needed by the other commands

    try:
        reply = find(config, None, None).command(command)
    except UserError as error:
        sys.stderr.write(f"heliocube: {error}\n")
        sys.exit(2)
    sys.stdout.write(f"{reply.text}\n")
    sys.exit(reply.exit_code)
