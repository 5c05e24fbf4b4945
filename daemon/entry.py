"""The start of the program: urgent commands go straight to the service, all others to the command line."""

import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.base.errors import ExitCode, UserError

_URGENT = ("stop", "stow")
_NOTHING_YET = "interrupted before its end; no whole result was written"
_MAYBE_TAKEN = "interrupted: the command may have been taken; see 'heliocube status'"
_OPTIONS = {
    "--config": "config",
    "-c": "config",
    "--api": "api",
    "--token-file": "token_file",
    "--why": "why",
    "--tracker": "tracker",
}


def main() -> None:
    """Carry out `heliocube stop` and `heliocube stow` before any large library is loaded, other commands as usual."""
    _open_closed_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A reason or a name may have letters that the terminal's encoding lacks.
        sys.stdout.reconfigure(errors="replace")
    if isinstance(sys.stdin, io.TextIOWrapper):
        # Typed text may be in another encoding than the locale's: it is then refused as an answer, and ends nothing.
        with suppress(io.UnsupportedOperation):
            # If the program itself came through standard input, some of that has been read, and this is not possible.
            sys.stdin.reconfigure(errors="surrogateescape")
    command, *rest = sys.argv[1:] or [""]
    _refuse_two_trackers(rest)
    given = _parse_plain_options(rest) if command in _URGENT else None
    interrupted = _NOTHING_YET if given is None else _MAYBE_TAKEN
    with _reporting_unwritten_answer(), _reporting_interruption(interrupted):
        if command not in _URGENT:
            _refuse_a_damaged_installation()
        if given is None:
            from daemon.commands.main import main as command_line  # noqa: PLC0415 - the large libraries

            command_line()
        else:
            _send_command(command, given)


def _open_closed_streams() -> None:
    """Open the null device in place of standard streams that were closed before the program started.

    Otherwise the next file that is opened, such as that of the records, would get the number of a closed stream, and
    with it the messages that a library writes to that stream.
    """
    while (opened := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(opened)
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for as long as we run
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - as above


def _refuse_two_trackers(words: Sequence[str]) -> None:
    """Leave with code 2 if --tracker is given twice: the command line would take only the last one."""
    if sum(word.partition("=")[0] == "--tracker" for word in words) > 1:
        sys.stderr.write(
            "heliocube: --tracker is given more than once, and a command is for one tracker: give the command for each;"
            " 'stop' and 'stow' without the option are for all\n"
        )
        sys.exit(2)


@contextmanager
def _reporting_interruption(sentence: str) -> Iterator[None]:
    """Leave with a sentence if Ctrl-C comes before a command can handle it, while libraries are loaded."""
    try:
        yield
    except (KeyboardInterrupt, ImportError) as error:
        # A library in C turns a Ctrl-C that comes while it is loaded into an ImportError.
        if not isinstance(error, KeyboardInterrupt) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        sys.stderr.write(f"heliocube: {sentence}\n")
        sys.exit(ExitCode.INTERRUPTED)


@contextmanager
def _reporting_unwritten_answer() -> Iterator[None]:
    """Leave with a sentence and its own exit code if standard output takes no more, as on a full disk."""
    try:
        try:
            yield
        except SystemExit as leaving:
            # If the reader has gone, the libraries leave with the exit code of a defect.
            if isinstance(leaving.__context__, BrokenPipeError):
                leaving.code = ExitCode.OUTPUT_FAILED
            raise
        finally:
            sys.stdout.flush()
    except OSError as error:
        # A long answer fails before its end. If standard output takes more now, the error came from something else.
        if error.filename is not None or _stdout_takes_more():
            raise
        # At its end Python would try again to write what is left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.stderr.write(f"heliocube: the answer cannot be written to standard output: {error.strerror}\n")
        sys.exit(ExitCode.OUTPUT_FAILED)


def _stdout_takes_more() -> bool:
    """Test whether standard output takes the end of a line."""
    try:
        os.write(sys.stdout.fileno(), b"\n")
    except OSError:
        return False
    return True


def _refuse_a_damaged_installation() -> None:
    """Leave with code 2 if another distribution has overwritten a package of ours; not called for stop and stow."""
    from daemon.base.installation import overwritten_package_text  # noqa: PLC0415 - a stop does not wait for it

    found = overwritten_package_text()
    if found is not None:
        sys.stderr.write(f"heliocube: {found}\n")
        sys.exit(2)


def _parse_plain_options(words: Sequence[str]) -> dict[str, str] | None:
    """Return the values of options, or None for words that the command line must handle: help, and mistakes."""
    given: dict[str, str] = {}
    left = iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        name = _OPTIONS.get(option)
        if name is None or (equals and option == "-c"):
            return None
        if not equals:
            value = next(left, "")
        if not value or value.startswith("-"):
            return None
        given[name] = value
    return given


def _send_command(command: str, given: dict[str, str]) -> None:
    from daemon.api.client import find_service  # noqa: PLC0415 - not needed by the other commands
    from daemon.commands.status.times import localise_times  # noqa: PLC0415 - as above
    from daemon.commands.wrapping import wrapped  # noqa: PLC0415 - as above

    paths = {name: Path(given[name]) for name in ("config", "token_file") if name in given}
    said = {name: given[name] for name in ("why", "tracker") if name in given}
    try:
        client = find_service(paths.get("config"), given.get("api"), paths.get("token_file"))
        reply = client.command(command, **said)
    except UserError as error:
        sys.stderr.write(wrapped(f"heliocube: {localise_times(str(error))}", sys.stderr) + "\n")
        sys.exit(error.exit_code)
    sys.stdout.write(wrapped(localise_times(reply.text), sys.stdout) + "\n")
    sys.exit(reply.exit_code)
