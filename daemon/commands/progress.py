"""The progress of a long command: a bar on a terminal, elsewhere a line a minute."""

import contextlib
import math
import threading
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from daemon.commands.answers import say


@contextlib.contextmanager
def progress_bar(
    console: Console, what: str = "simulating", *, line_every_s: float = 60.0
) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on a terminal, elsewhere a line a minute; yields a function of the share done, 0..1."""
    columns = (TextColumn(what), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    # With its default period `Progress` would know no speed if a step takes longer than half a minute.
    with Progress(
        *columns, console=console, disable=not console.is_terminal, transient=True, speed_estimate_period=math.inf
    ) as progress:
        number = progress.add_task(what, total=1.0)
        # A speed needs two steps. This is the first, as the real ones may end at nearly the same time.
        progress.advance(number, 0.0)

        def advance(share: float) -> None:
            progress.update(number, completed=share)

        if console.is_terminal:
            yield advance
        else:
            with _lines(progress.tasks[0], line_every_s):
                yield advance


@contextlib.contextmanager
def _lines(task: Task, every_s: float) -> Iterator[None]:
    """Say on standard error at intervals how far a task is, also in the middle of a step."""
    over = threading.Event()

    def print_progress() -> None:
        while not over.wait(every_s):
            # The work goes on even if nobody reads any more.
            with contextlib.suppress(OSError):
                say(_line(task), err=True)

    printer = threading.Thread(target=print_progress, name="progress", daemon=True)
    printer.start()
    try:
        yield
    finally:
        over.set()
        printer.join()


def _line(task: Task) -> str:
    left_s = task.time_remaining
    left = f", about {_duration_text(left_s)} left" if left_s else ""
    return f"{task.description}: {math.floor(task.percentage)} % done after {_duration_text(task.elapsed or 0.0)}{left}"


def _duration_text(duration_s: float) -> str:
    hours, minutes = divmod(max(round(duration_s / 60.0), 1), 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
