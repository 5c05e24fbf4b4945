"""What a person at a setup sees: plain lines with a little colour, which carries no information of its own."""

import contextlib
import textwrap

from rich.console import Console
from rich.text import Text

from daemon.commands.setup.dialogue import SetupDialogue
from daemon.commands.setup.saved_answers import Answer
from daemon.commands.setup.steps import SetupStep
from daemon.config import keys

_WIDEST = 96


class SetupScreen:
    """Writes to a console and reads lines from it."""

    def __init__(self, console: Console, *, simulated: bool = False) -> None:
        self._console = console
        self._chapter = ""
        self._last_step_name = ""
        self.simulated = simulated

    def say(self, text: str, style: str = "") -> None:
        """Write a line, broken at the terminal's width; the parts begin below each other."""
        for line in text.splitlines() or [""]:
            words = line.lstrip()
            indent = " " * (len(line) - len(words) + 2 * words.startswith(("- ", "! ")))
            width = min(self._console.width, _WIDEST)
            for part in textwrap.wrap(
                line, width, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
            ) or [""]:
                # The terminal may have hung up; that must not prevent a move from being stopped.
                with contextlib.suppress(OSError):
                    self._console.print(Text(part, style), soft_wrap=True)

    def refuse(self, sentence: str) -> None:
        """Say why an answer is not taken, or what went wrong."""
        self.say(f"  ! {sentence}", "bold red")

    def show_chapter(self, dialogue: SetupDialogue, step: SetupStep) -> None:
        """Write the name of the step's chapter, if the chapter begins here."""
        if step.chapter == self._chapter:
            return
        self._chapter = step.chapter
        number, of = dialogue.chapter_position()
        mark = "  SIMULATED" if self.simulated else ""
        self.say("")
        self.say(f"{number}/{of} {step.chapter}{mark}", "bold")

    def is_new_step(self, step: SetupStep) -> bool:
        """Tell whether another step was asked last, and note this one."""
        last, self._last_step_name = self._last_step_name, step.name
        return last != step.name

    def ask(self, dialogue: SetupDialogue, step: SetupStep) -> str:
        """Ask a step and return what was typed; `EOFError` or `KeyboardInterrupt` if there is no answer."""
        offered = dialogue.default_answer()
        if self.is_new_step(step):
            self.say(f"  {step.question}")
            if step.kind != "action" and (step.choices or offered is None):
                self.say(f"  {dialogue.expected()[0].upper()}{dialogue.expected()[1:]}.", "dim")
        return self.prompt(_label(step), _hint(step, offered))

    def prompt(self, label: str, hint: str) -> str:
        """Show a label and a hint, and return what is typed; `EOFError` if nothing can be typed."""
        try:
            return self._console.input(
                Text.assemble("  ", (label, "bold"), (f" [{hint}]" if hint else "", "cyan"), ": ")
            )
        except OSError:
            raise EOFError from None


def _label(step: SetupStep) -> str:
    return step.name if step.kind == "key" else "answer"


def _hint(step: SetupStep, offered: Answer) -> str:
    """Return the text on what Enter takes or does."""
    if step.kind == "action":
        return "Enter does it, or skip"
    shown = "" if offered is None else _shown(step, offered)
    return "none" if step.optional and not shown else shown


def _shown(step: SetupStep, value: Answer) -> str:
    known = keys.keys()
    text = (
        ", ".join(map(str, value))
        if isinstance(value, list)
        else f"{value:.10g}"
        if isinstance(value, float)
        else str(value)
    )
    unit = known[step.name].unit if step.name in known else ""
    return f"{text} {unit}".rstrip()
