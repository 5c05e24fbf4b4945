"""What `heliocube simulate` tells on the terminal while it works and when it is done."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from daemon.config.sections import Settings
from daemon.studies.simulate import Summary


@contextlib.contextmanager
def progress_bar(console: Console, what: str = "simulating") -> Iterator[Callable[[float], None]]:
    """Show a progress bar on a terminal, nothing elsewhere; yields the function that takes the share done, 0..1."""
    columns = (TextColumn(what), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task(what, total=1.0)

        def advance(share: float) -> None:
            progress.update(task, completed=share)

        yield advance


def report(summary: Summary, settings: Settings, out: Path, errors: Console, console: Console) -> None:
    """Print what was simulated and where the tables are; a warning goes to `errors`."""
    if summary.warning:
        errors.print(f"heliocube: warning: {summary.warning}", markup=False, highlight=False, soft_wrap=True)
    site = settings.site
    hours = ", ".join(f"{mode} {seconds / 3600:.1f} h" for mode, seconds in summary.mode_s.items() if seconds >= 180)
    lines = (
        (
            f"SIMULATED {site.name} ({site.latitude_deg:g}, {site.longitude_deg:g}), law {settings.law.name}, "
            f"weather {settings.simulation.weather}, seed {settings.simulation.seed}"
        ),
        (
            f"{summary.scans} scans, {summary.decisions} decisions, {summary.moves} moves, "
            f"{summary.travel_deg:.0f} degrees of travel"
        ),
        f"modes: {hours}",
        f"tables in {out}",
    )
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
