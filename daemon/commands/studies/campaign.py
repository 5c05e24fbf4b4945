"""`heliocube campaign`: faults and commands at random, against where the axes truly stand."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, message_printer, print_json
from daemon.commands.options import ClusterOption, ForceOption, JobsOption, checked_seed, chosen_workers

_DRAWING_OPTIONS = ("--seeds", "--from", "--hours", "--trackers", "--positioner", "--only", "--without")
"""The options of schedules that are drawn."""


@signals_as_ctrl_c()
def campaign(
    context: typer.Context,
    seeds: Annotated[int, typer.Option(min=1, metavar="N", help="How many seeds.")] = 10,
    first: Annotated[
        int, typer.Option("--from", min=0, callback=checked_seed, metavar="SEED", help="The first seed.")
    ] = 1,
    hours: Annotated[float, typer.Option(min=0.1, max=8760, help="Hours of virtual time for each seed.")] = 3.0,
    trackers: Annotated[int, typer.Option(min=1, max=10, metavar="N", help="How many trackers the service has.")] = 1,
    positioner: Annotated[
        Literal["pozsol", "rotctld"],
        typer.Option(help="Positioner of the rig: a POZSOL unit, or a rotator with the faults that it can have."),
    ] = "pozsol",
    only: Annotated[
        str | None,
        typer.Option(metavar="FAULTS", help="Only these faults, separated by commas; or COMPONENT or COMPONENT:FAULT."),
    ] = None,
    without: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Faults and commands to leave out, separated by commas.")
    ] = None,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
    schedule: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Run this schedule instead, such as a seed-N.json of --keep.")
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Print each schedule and the service's log.")] = False,
    reliability: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Instead, try every fault alone and every pair of faults, and write this page."
        ),
    ] = None,
    keep: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for failures, each as seed-N.json, reduced at the end.")
    ] = Path("campaign-failures"),
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Attack the simulated rig with random faults and commands, and check every promise about motion.

    The same seed and hours give the same run. A failure is reduced to the faults that cause it.
    Exit code 1: a promise was broken.
    """
    from daemon.store.outputs import check_outputs

    workers = chosen_workers(jobs, cluster)
    if reliability is not None:
        without_effect = (*_DRAWING_OPTIONS, "--schedule", "--show", "--keep")
        _refuse_given(context, "--reliability tries every fault in its own way", without_effect)
        check_outputs([reliability], "--reliability", force=force)
    elif schedule is not None:
        _refuse_given(context, "--schedule has its own faults and hours", _DRAWING_OPTIONS)
    else:
        check_outputs([keep / f"seed-{seed}.json" for seed in range(first, first + seeds)], "--keep", force=force)
    from daemon.studies.campaign.matrix import chosen_schedules

    # This checks only the names, so that a mistake is reported before the simulator is loaded.
    schedules = chosen_schedules(seeds, first, hours, _words(only), _words(without), schedule, trackers, positioner)
    from daemon.commands.progress import progress_bar
    from daemon.studies.campaign.campaign import Campaign
    from daemon.studies.campaign.reliability import write_reliability

    say, errors = message_printer(as_json=as_json), Console(stderr=True)

    if reliability is not None:
        with progress_bar(errors, "drilling") as progress:
            beyond = write_reliability(reliability, workers, progress)
        for text in (*beyond, f"written: {reliability}"):
            say(text)
        if as_json:
            print_json({"beyond": beyond, "written": reliability})
        raise typer.Exit(1 if beyond else 0)
    campaign = Campaign(schedules, workers, say, keep, show=show)
    with progress_bar(errors, "attacking") as progress:
        code = campaign.run(progress)
    if as_json:
        print_json(campaign.summary.as_dict())
    raise typer.Exit(code)


def _refuse_given(context: typer.Context, why: str, names: tuple[str, ...]) -> None:
    """Raise `UserError` for options that a person has given although they would have no effect."""
    sources = {option.opts[0]: context.get_parameter_source(option.name or "") for option in context.command.params}
    given = [name for name, source in sources.items() if name in names and source and source.name != "DEFAULT"]
    if given:
        raise UserError(f"{why}, so {' and '.join(given)} would do nothing: leave out the one or the other")


def _words(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(word.strip() for word in text.split(",") if word.strip())
