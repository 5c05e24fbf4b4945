"""The stop of a move that a person watches: any key of the terminal, without Enter, or a signal to end the program."""

import contextlib
import select
import signal
import sys
from collections.abc import Callable, Iterator

# A terminal that is closed, or a connection that is lost, hangs up.
_ENDS = ("SIGINT", "SIGTERM", "SIGHUP")


class StopKeys:
    """Tells whether to stop; once it has said so, it always does.

    Attributes
    ----------
    exit_requested
        Whether Ctrl-C, a hang-up or an order to end came, so that the program should end after the stop.
    """

    def __init__(self, pressed: Callable[[], bool]) -> None:
        self._pressed = pressed
        self._must_stop = False
        self.exit_requested = False

    def pressed(self) -> bool:
        """Tell whether, since this began, a key has been pressed or the program been told to end."""
        self._must_stop = self._must_stop or self.exit_requested or self._pressed()
        return self._must_stop

    def request_exit(self) -> None:
        """Note that the program has been told to end."""
        self.exit_requested = True


@contextlib.contextmanager
def stop_keys() -> Iterator[StopKeys | None]:
    """Yield the watch of keys and signals; None if there is no terminal, so that no key could be pressed.

    Meanwhile no signal ends the program, because the axes would go on to their end.
    """
    if not sys.stdin.isatty():
        yield None
        return
    with _keys() as pressed:
        keys = StopKeys(pressed)
        numbers = [getattr(signal, name) for name in _ENDS if hasattr(signal, name)]
        before = {number: signal.signal(number, lambda *_: keys.request_exit()) for number in numbers}
        try:
            yield keys
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


@contextlib.contextmanager
def _keys() -> Iterator[Callable[[], bool]]:
    if sys.platform == "win32":
        import msvcrt

        yield msvcrt.kbhit
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal, termios.TCSAFLUSH)
    # Ctrl-Z and Ctrl-\ would leave a move unwatched, and Ctrl-S block the next output: make them keys like others.
    flags, *rest, characters = termios.tcgetattr(terminal)
    characters[termios.VSUSP] = characters[termios.VQUIT] = b"\0"
    termios.tcsetattr(terminal, termios.TCSANOW, [flags & ~termios.IXON, *rest, characters])
    try:
        yield lambda: bool(select.select([terminal], [], [], 0)[0])
    finally:
        # Discard the keys that stopped a move: they do not answer the next question. A hung-up terminal gives an error.
        with contextlib.suppress(termios.error):
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)
