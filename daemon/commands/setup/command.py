"""`heliocube setup`: from a bare machine to a checked configuration and a first move, with a person at each step."""

import asyncio
import os
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.base.errors import UserError
from daemon.base.words import pluralise
from daemon.commands.options import FILES, RoleChoice, unit_role

if TYPE_CHECKING:
    from daemon.commands.setup.dialogue import SetupDialogue
    from daemon.commands.setup.screen import SetupScreen
    from daemon.commands.setup.steps import SetupStep

# The exit code that a shell gives a program that Ctrl-C ended.
INTERRUPTED_EXIT_CODE = 130

app = typer.Typer()


@app.command(rich_help_panel=FILES)
def setup(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="The configuration to write, such as /etc/heliocube/tracker.toml.")
    ],
    role: Annotated[
        RoleChoice | None,
        typer.Option(help="What the machine will do. If left out you are asked, unless a unit starts this FILE."),
    ] = None,
    anew: Annotated[bool, typer.Option("--anew", help="Forget earlier answers and begin again.")] = False,
) -> None:
    """Set up a new rig: ask for its site, query its instruments, make the first move, write its configuration.

    You can leave at any time with Ctrl-C (exit code 130), and continue with the same command.
    Only the first move moves anything: you confirm it, any key stops it, and telemetry must show that it went right.
    """
    from rich.console import Console

    from daemon.commands.setup.dialogue import SetupDialogue
    from daemon.commands.setup.saved_answers import SetupAnswers, answers_path, keep_answers, load_answers
    from daemon.commands.setup.screen import SetupScreen
    from daemon.commands.setup.steps import BENCH_RIG, RIG, ROLE
    from daemon.config.template import FILE_NAME

    file = file.absolute()
    if file.is_dir():
        raise UserError(f"{file} is a folder: name the file to write, such as {file / FILE_NAME}")
    place = answers_path(file)
    kept = SetupAnswers() if anew else load_answers(place)
    if role is not None and kept.answers.get(ROLE, role.value) != role.value:
        raise UserError(
            f"--role {role.value}: the answers from before in {place} are for the role {kept.answers[ROLE]}; leave"
            " --role out to go on with them, or begin with --anew"
        )
    dialogue = SetupDialogue(kept, file)
    screen = SetupScreen(Console(highlight=False), simulated=kept.answers.get(RIG) == BENCH_RIG)
    _greet(screen, file, place, len(kept.answers))
    chosen = unit_role(file) if role is None else role.value
    if chosen is not None and ROLE not in kept.answers:
        dialogue.take_answer(chosen)
    keep_answers(place, dialogue.saved_answers)
    try:
        while (step := dialogue.current_step()) is not None:
            screen.simulated = dialogue.saved_answers.answers.get(RIG) == BENCH_RIG
            screen.show_chapter(dialogue, step)
            _ask_step(dialogue, screen, step)
            keep_answers(place, dialogue.saved_answers)
        _finish(dialogue, screen, file)
    except (KeyboardInterrupt, EOFError):
        screen.say("")
        screen.say(f"Left. Your answers are in {place}; go on with: heliocube setup {file}")
        raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    place.unlink(missing_ok=True)


def _greet(screen: "SetupScreen", file: Path, place: Path, answered: int) -> None:
    screen.say(f"Setting up {file}.", "bold")
    screen.say("Enter takes the answer in brackets, 'back' takes the latest answer back, Ctrl-C leaves.")
    if answered:
        screen.say(f"{pluralise(answered, 'answer is', 'answers are')} there from before, in {place}.")


def _ask_step(dialogue: "SetupDialogue", screen: "SetupScreen", step: "SetupStep") -> None:
    """Ask one step, and take the answer or say why it does not fit."""
    from daemon.commands.setup.steps import MOVE, SUN

    if step.name == SUN:
        from daemon.commands.setup.instrument_checks import sun_sentence

        screen.say(f"  {sun_sentence(dialogue.settings(), _now_s())}")
    if step.name.endswith((".port", ".line", ".resource")) and step.kind == "key":
        _name_ports(screen)
    if step.name == MOVE and screen.is_new_step(step):
        _before_the_move(dialogue, screen)
    said = screen.prompt("type", "move, or skip") if step.name == MOVE else screen.ask(dialogue, step)
    try:
        _take(dialogue, screen, step, said)
    except UserError as error:
        screen.refuse(str(error))


def _name_ports(screen: "SetupScreen") -> None:
    from daemon.commands.setup.instrument_checks import serial_ports

    names = serial_ports()
    if names:
        screen.say(f"  Serial ports here: {', '.join(names)}", "dim")


def _take(dialogue: "SetupDialogue", screen: "SetupScreen", step: "SetupStep", said: str) -> None:
    """Take what was typed; raises `UserError` if it does not fit, or if the action cannot be done."""
    from daemon.commands.setup.steps import MOVE, SKIPPED

    word, go = said.strip().lower(), "move" if step.name == MOVE else ""
    if word == "back":
        if not dialogue.back():
            raise UserError("this is the first question")
    elif step.kind != "action":
        dialogue.take_answer(said)
    elif word == "skip":
        dialogue.set_answer(SKIPPED)
    elif word == go:
        dialogue.set_answer(_act(dialogue, screen, step))
    else:
        raise UserError(f"say {go or 'Enter'}, skip or back")


def _act(dialogue: "SetupDialogue", screen: "SetupScreen", step: "SetupStep") -> float | str:
    """Do an action and return its result; raises `UserError`."""
    from daemon.base.clock import SystemClock
    from daemon.commands.setup import instrument_checks, steps

    settings, clock = dialogue.settings(), SystemClock()

    def say(text: str) -> None:
        screen.say(f"    {text}")

    look: dict[str, Callable[[], Coroutine[Any, Any, None]]] = {
        steps.LOOK_CUBE: lambda: instrument_checks.check_cube(settings, clock, say),
        steps.LOOK_POSITIONER: lambda: instrument_checks.check_positioner(settings, clock, say),
        steps.LOOK_LOAD: lambda: instrument_checks.check_load(settings, clock, say),
    }
    if step.name in look:
        _run(look[step.name]())
        return "done"
    return _move(dialogue, say)


def _move(dialogue: "SetupDialogue", say: Callable[[str], object]) -> float | str:
    from daemon.base.clock import SystemClock
    from daemon.commands.records_folder import with_records_folder
    from daemon.commands.setup.any_key import stop_keys
    from daemon.commands.setup.first_move import Bounds, first_move
    from daemon.commands.setup.instrument_checks import require_movable
    from daemon.rigs.first_look import check_noted_obstacles
    from daemon.rigs.real import build_positioner

    settings, clock = dialogue.settings(), SystemClock()
    require_movable(settings)
    # A service of this file may exist already, with reasons of its own not to move the rig.
    look = partial(check_noted_obstacles, with_records_folder(settings, dialogue.file, os.environ))
    bounds = Bounds(
        settings.limits.limits(), settings.motion.tolerance_deg, settings.instruments.positioner.slowest_deg_per_s
    )
    with stop_keys() as keys:
        if keys is None:
            raise UserError(
                "nothing is moved without a terminal, because it takes a key to stop the motion: run this in a terminal"
            )
        try:
            speed = _run(first_move(build_positioner(settings, clock), bounds, clock, say, keys.pressed, look))
        except UserError as error:
            if not keys.exit_requested:
                raise
            say(str(error))
        if keys.exit_requested:
            raise KeyboardInterrupt
    return round(speed, 3) or "done"


def _before_the_move(dialogue: "SetupDialogue", screen: "SetupScreen") -> None:
    settings = dialogue.settings()
    for line in (
        f"A and B will move by two degrees and back, one by one, inside {settings.limits.limits()};",
        "then A moves once more for you to stop it with a key. Before that, all of this must be true:",
        "- somebody stands at the mechanics with a hand on the SUPPLY SWITCH OF THE MOTORS",
        "- nobody is within reach of the arms; no tools, no cables lie across their way",
        "- the wind is below 5 m/s, and the motors' supply is on",
        "A key stops the axes only while this program and the cable work: it is no emergency stop.",
    ):
        screen.say(f"  {line}")


def _run(work: Coroutine[Any, Any, Any]) -> Any:
    """Run the work; an error of the instrument gives one sentence."""
    from drivers.errors import DeviceError

    try:
        return asyncio.run(work)
    except DeviceError as error:
        raise UserError(str(error)) from error


def _finish(dialogue: "SetupDialogue", screen: "SetupScreen", file: Path) -> None:
    from daemon.commands.file_check import check_file
    from daemon.commands.setup.finish import write_setup_files
    from daemon.commands.setup.steps import LATER, SKIPPED

    written = write_setup_files(dialogue, file)
    screen.say("")
    screen.say("Written:", "bold")
    for line in written:
        screen.say(f"  {line}")
    try:
        check_file(file, RoleChoice(dialogue.role()))
    except UserError as error:
        screen.refuse(str(error))
    open_ends = [
        step.remaining_task
        for step in dialogue.steps()
        if dialogue.saved_answers.answers[step.name] in (SKIPPED, LATER)
    ]
    if open_ends:
        screen.say("Not done yet:", "bold")
        for sentence in open_ends:
            screen.say(f"  - {sentence.format(file=file)}")
    _say_next_steps(dialogue, screen, file)


def _say_next_steps(dialogue: "SetupDialogue", screen: "SetupScreen", file: Path) -> None:
    from daemon.commands.setup.dialogue import NEW_KEY
    from daemon.commands.setup.finish import start_lines
    from daemon.commands.setup.steps import KEY

    role = dialogue.role()
    screen.say("Next:", "bold")
    if role != "both":
        path = file.parent / dialogue.key_file()
        verb = "carry it to" if dialogue.saved_answers.answers.get(KEY) == NEW_KEY else "compare it on"
        screen.say(f"  the key {path} has to be the same on both machines: {verb} the other one, then sha256sum both")
    if role != "cube":
        screen.say("  widen [limits] step by step: docs/install.md, section 7")
        screen.say("  let the tracker hear of the wind: docs/mqtt.md")
    for line in start_lines(file, role):
        screen.say(f"  {line}")


def _now_s() -> float:
    from daemon.base.clock import SystemClock

    return SystemClock().utc()
