"""Writes a manual page for each command of the program, from what `--help` is made of.

Called by deploy/deb/build as ``pages.py VERSION SECONDS_SINCE_1970 FOLDER``, with the Python of the environment.
"""

import re
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from typer.main import get_command

from daemon.commands.main import app

NAME = "heliocube"
# Rich's marks for bold and colours, which a page has none of.
_MARKS = re.compile(r"\[/?[a-z][a-z_ ]*\]")


def main() -> None:
    """Write the pages; the caller compresses them."""
    version, made_s, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    day = datetime.fromtimestamp(made_s, UTC).date().isoformat()
    for words, command in commands([NAME], get_command(app)):
        (folder / f"{'-'.join(words)}.1").write_text(page(words, command, version, day), encoding="utf-8")


def commands(words: list[str], command: Any) -> Iterator[tuple[list[str], Any]]:
    """Yield a command and all below it, each with its words."""
    yield words, command
    for name, below in sorted(getattr(command, "commands", {}).items()):
        if not below.hidden:
            yield from commands([*words, name], below)


def page(words: list[str], command: Any, version: str, day: str) -> str:
    """Return the page of one command in man's own macros."""
    context = command.context_class(command, info_name=" ".join(words))
    paragraphs = _plain(command.help or command.short_help or "").split("\n\n")
    synopsis = " ".join(command.collect_usage_pieces(context))
    lines = [
        f'.TH "{"-".join(words).upper()}" 1 "{day}" "heliocube {version}" "heliocube"',
        *(".SH NAME", f"{_text('-'.join(words))} \\- {_text(_first_sentence(paragraphs[0]))}"),
        *(".SH SYNOPSIS", f".B {_text(' '.join(words))}", _text(synopsis)),
        ".SH DESCRIPTION",
    ]
    for paragraph in paragraphs:
        lines += [".PP", _text(" ".join(paragraph.split()))]
    options = [part for part in command.get_params(context) if not getattr(part, "hidden", False)]
    if options:
        lines.append(".SH OPTIONS")
    for part in options:
        lines += _option(part)
    below = [(name, one) for name, one in sorted(getattr(command, "commands", {}).items()) if not one.hidden]
    if below:
        lines.append(".SH COMMANDS")
    for name, one in below:
        lines += [".TP", f"\\fB{_text(name)}\\fR", _text(_plain(one.get_short_help_str(300)))]
    lines.append(".SH SEE ALSO")
    others = [f"{'-'.join([*words, name])}" for name, _ in below] + (["-".join(words[:-1])] if words[1:] else [])
    lines += [", ".join(f"\\fB{_text(name)}\\fR(1)" for name in others) or "/usr/share/doc/heliocube"]
    return "\n".join(lines) + "\n"


def _option(part: Any) -> list[str]:
    is_option = part.opts[0].startswith("-")
    value = part.metavar or part.name.replace("_", "-").upper()
    head = f"\\fB{_text(', '.join([*part.opts, *part.secondary_opts]))}\\fR" if is_option else f"\\fI{_text(value)}\\fR"
    if is_option and not part.is_flag:
        head += f" \\fI{_text(value)}\\fR"
    return [".TP", head, _text(" ".join(_plain(getattr(part, "help", None) or "").split())) or "\\&"]


def _plain(text: str) -> str:
    return _MARKS.sub("", text.replace("\b", "").replace("\f", "")).strip()


def _first_sentence(text: str) -> str:
    return " ".join(text.split()).partition(". ")[0].removesuffix(".")


def _text(text: str) -> str:
    """Return a text in which roff finds nothing to obey, not even at the beginning of a line."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq")
    return f"\\&{escaped}" if escaped.startswith(".") else escaped


if __name__ == "__main__":
    main()
