"""Any key of the terminal, without Enter: what stops a move under a person's hand."""

import contextlib
import select
import sys
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def any_key() -> Iterator[Callable[[], bool] | None]:
    """Yield a function that tells whether a key has been pressed since this began; once it has, it stays so.

    None where no terminal is, so that no key could be. Ctrl-C stays what it is.
    """
    if not sys.stdin.isatty():
        yield None
    elif sys.platform == "win32":
        yield _latched(_pressed_on_windows)
    else:
        import termios
        import tty

        terminal = sys.stdin.fileno()
        before = termios.tcgetattr(terminal)
        tty.setcbreak(terminal, termios.TCSAFLUSH)
        try:
            yield _latched(lambda: bool(select.select([terminal], [], [], 0)[0]))
        finally:
            # What was typed to stop a move is no answer to the next question.
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)


def _latched(pressed: Callable[[], bool]) -> Callable[[], bool]:
    seen = False

    def look() -> bool:
        nonlocal seen
        seen = seen or pressed()
        return seen

    return look


def _pressed_on_windows() -> bool:
    if sys.platform == "win32":
        import msvcrt

        return msvcrt.kbhit()
    return False
