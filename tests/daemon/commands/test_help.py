import re
from itertools import pairwise

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from daemon.commands.main import app
from daemon.service.operator_commands import COMMAND_NAMES


def commands(command, path=()):
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*path, name))


COMMANDS = dict(commands(get_command(app)))


def words(text):
    """The words of a text, without line breaks and boxes."""
    return " ".join(re.findall(r"[^\s│╭╮╰╯─]+", text))


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_help_fits_its_width_and_shows_every_word(path, columns):
    command = COMMANDS[path]
    shown = CliRunner(env={"COLUMNS": str(columns)}).invoke(app, [*path, "--help"])
    assert shown.exit_code == 0
    assert max(len(line) for line in shown.output.splitlines()) <= columns
    assert not re.search(r"<[a-z]|list\[", shown.output), "a type of Python where a person looks for a word"
    lines = [line.strip() for line in shown.output.splitlines()]
    for line, following in pairwise(lines):
        if line[-1:].isalnum() and following[:1].isalpha():
            assert len(f"{line} {following.split()[0]}") > columns - 2, f"broken before its end: {line}"
    told = words(shown.output)
    for parameter in command.params:
        about = getattr(parameter, "help", None)
        assert about, f"{parameter.name} has no text"
        assert about.endswith("."), about
        assert words(about) in told, about


@pytest.mark.parametrize("order", sorted({*COMMAND_NAMES} - {"mode", "acknowledge"}))
def test_the_help_of_each_tracker_command_explains_its_exit_codes(order):
    told = words(CliRunner(env={"COLUMNS": "80"}).invoke(app, [order, "--help"]).output)
    seen = "Exit code: 0 if its effect was seen, complete or under way; 3 if it was not seen in time;"
    assert f"{seen} 5 if the service cannot be reached; 6 if it is refused." in told


def test_the_version_option_prints_the_version():
    shown = CliRunner().invoke(app, ["--version"])
    assert re.fullmatch(r"heliocube \d+\.\d+\.\d+\S*\n", shown.output)


@pytest.mark.parametrize(("typed", "completed"), [("sim", "simulate"), ("sto", "stow"), ("config i", "init")])
def test_the_shell_completes_commands(typed, completed):
    *before, last = ["heliocube", *typed.split()]
    environment = {
        "_HELIOCUBE_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join([*before, last]),
        "COMP_CWORD": str(len(before)),
    }
    shown = CliRunner(env=environment).invoke(app, [], prog_name="heliocube")
    assert completed in shown.output.split()
