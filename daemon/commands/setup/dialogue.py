"""The course of a setup: which step is next, and whether an answer fits it. It shows nothing and moves nothing."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daemon.base.addresses import CUBE_LISTEN
from daemon.base.errors import UserError
from daemon.bridge.signing import load_key
from daemon.commands import options
from daemon.commands.setup.saved_answers import Answer, SetupAnswers, answers_path
from daemon.commands.setup.steps import BENCH, BENCH_RIG, KEY, RIG, ROLE, SetupContext, SetupStep, plan
from daemon.config import keys
from daemon.config.file import ConfigError, load_settings, override
from daemon.config.migrate import RENAMED_KEYS
from daemon.config.section import read_tables
from daemon.config.settings import Settings
from daemon.config.template import FILE_NAME, KEY_FILE_NAME, TOKEN_FILE_NAME

NEW_KEY = "new"
_NONE = ("none", "-")
_YES = {"y": "yes", "n": "no"}


class SetupDialogue:
    """Leads through the steps, one by one, from what is known.

    Parameters
    ----------
    kept
        The answers so far.
    file
        The configuration that will be written. If it is there already, its values are the defaults.

    Attributes
    ----------
    file
        That configuration.
    """

    def __init__(self, kept: SetupAnswers, file: Path) -> None:
        self._kept = kept
        self.file = file
        own: dict[str, Any] = {}
        if file.exists():
            load_settings(file)
            # install.sh installs a file with the site of the paper, which nobody may take by Enter.
            own = {path: value for path, value in _values_of(file).items() if not _is_paper_site_value(path, value)}
        if "tracker" in own:
            raise UserError(f"{file} has tables of trackers, which a setup does not ask for: change that file by hand")
        self._own = own
        self._bench_values: dict[str, Any] = {}
        try:
            self._read_bench()
        except UserError as error:
            raise UserError(
                f"the answers from before in {answers_path(file)} are for a bench, and {error}; start the bench"
                " again, or begin with --anew"
            ) from None

    @property
    def saved_answers(self) -> SetupAnswers:
        """The answers so far."""
        return self._kept

    @property
    def context(self) -> SetupContext:
        """The answers and values that decide the steps."""
        bench = self._kept.answers.get(RIG) == BENCH_RIG
        # A file from practice on a bench has the bench's clock and addresses, which a real rig must not take.
        own = self._own if self._own.get("instruments.bench", False) is bench else {}
        return SetupContext(self._kept.answers, self._bench_values or own)

    def steps(self) -> list[SetupStep]:
        """Return every step that the answers lead to, answered ones included."""
        return plan(self.context)

    def current_step(self) -> SetupStep | None:
        """Return the first step without an answer; None if all are answered."""
        return next((step for step in self.steps() if step.name not in self._kept.answers), None)

    def chapter_position(self) -> tuple[int, int]:
        """Return the number of the present chapter, from 1, and how many there are."""
        chapters = list(dict.fromkeys(step.chapter for step in self.steps()))
        step = self.current_step()
        return (len(chapters) if step is None else chapters.index(step.chapter) + 1), len(chapters)

    def default_answer(self) -> Answer:
        """Return what Enter takes now; None if an answer has to be typed."""
        step = self.current_step()
        if step is None or step.kind == "action":
            return None
        return self._kept.offered.get(step.name, step.default)

    def take_answer(self, text: str) -> None:
        """Take a person's answer to the present step; an empty answer takes what is offered.

        Raises
        ------
        UserError
            The answer does not fit: one sentence says what would.
        """
        step = self.current_step()
        if step is None:
            return
        said = text.strip()
        if not said.isprintable():
            raise UserError(
                f"{ascii(said)[:60]} has a key that is no letter, such as an arrow, or a letter that is not UTF-8: type"
                " it again without that"
            )
        value = self.default_answer() if not said else _parse_answer(step, said, self._key(step))
        if value is None and not step.optional:
            raise UserError(f"this has no default: {self.expected()}")
        self.set_answer(value)

    def set_answer(self, value: Answer) -> None:
        """Take the value of the present step, or the result of an action; raises `UserError` if it does not fit."""
        step = self.current_step()
        if step is None:
            return
        if step.kind == "confirm" and value == "no":
            raise UserError(step.refusal)
        answers = {**self._kept.answers, step.name: value}
        changed = {"answers": answers}
        if step.name == RIG and value != self._kept.offered.get(RIG):
            # Answers about the other rig, from before somebody went back, are not offered for this one.
            changed["offered"] = {}
        before, self._kept = self._kept, self._kept.model_copy(update=changed)
        try:
            if step.name == ROLE:
                self._check_role(str(value))
            if step.name in (RIG, BENCH):
                self._read_bench()
            if step.name == KEY:
                self._check_key(str(value))
            self.settings()
        except UserError as error:
            self._kept = before
            raise UserError(self._refusal(error)) from None

    def back(self) -> bool:
        """Take the latest answer back, to be given again; False if there is none."""
        if not self._kept.answers:
            return False
        answers = dict(self._kept.answers)
        name, value = answers.popitem()
        offered = {**self._kept.offered, name: value}
        self._kept = self._kept.model_copy(update={"answers": answers, "offered": offered})
        if name in (BENCH, RIG):
            self._bench_values = {}
        return True

    def expected(self) -> str:
        """Return in words what the present step takes."""
        step = self.current_step()
        if step is None:
            return ""
        if step.choices:
            return f"say {_join_with_or(step.choices)}"
        key = self._key(step)
        optional = " or none" if step.optional else ""
        return "it is needed" if key is None else f"it takes {_in_words(key)}{optional}"

    def values(self) -> dict[str, Any]:
        """Return what the configuration will say, by path."""
        known = self.context
        paths = keys.keys(known.chosen_drivers())
        found = {path: value for path, value in known.file_values.items() if path in paths}
        found |= {name: value for name, value in known.answers.items() if name in paths}
        found["instruments.kind"] = "real"
        found["instruments.bench"] = known.answers.get(RIG) == BENCH_RIG
        found["bridge.key_file"] = self.key_file()
        found.setdefault("api.token_file", TOKEN_FILE_NAME)
        if self.role() == "cube":
            # Another port than the tracker's: both services may run on one machine.
            found.setdefault("api.listen", CUBE_LISTEN)
        return found

    def key_file(self) -> str:
        """Return the key's file as the configuration will name it."""
        chosen = self._kept.answers.get(KEY)
        known = self.context.file_values.get("bridge.key_file") or KEY_FILE_NAME
        return str(known if chosen in (None, NEW_KEY) else chosen)

    def settings(self) -> Settings:
        """Return the settings from the answers; raises `ConfigError`, but not for keys that are still to be asked."""
        values = {path: value for path, value in self.values().items() if value is not None}
        to_come = [step.name for step in self.steps() if step.name not in self._kept.answers]
        return override(Settings(), _tables(values), to_come)

    def role(self) -> str:
        """Return the role, ``both`` until it is answered."""
        return str(self._kept.answers.get(ROLE, "both"))

    def _key(self, step: SetupStep) -> keys.Key | None:
        return keys.keys(self.context.chosen_drivers()).get(step.name) if step.kind == "key" else None

    def _read_bench(self) -> None:
        folder = self._kept.answers.get(BENCH)
        if self._kept.answers.get(RIG) != BENCH_RIG:
            return
        if self._own and not self._own.get("instruments.bench", False):
            raise UserError(
                f"{self.file} is there already and is not of a bench, and the bench's addresses and clock would replace"
                " its own: practise with another file, such as 'heliocube setup practice.toml'"
            )
        if folder is None:
            return
        file = _expand_home(str(folder)) / FILE_NAME
        found = _values_of(file)
        if found.get("instruments.bench") is not True:
            raise UserError(f"{file} was not written by a bench: start one with 'heliocube bench --dir {folder}'")
        self._bench_values = found

    def _refusal(self, error: UserError) -> str:
        """Return the first problem, without the name of a file, as a dialogue has none."""
        if not isinstance(error, ConfigError):
            return str(error)
        problem = error.problems[0]
        key = problem.partition(" = ")[0]
        if key not in keys.keys(self.context.chosen_drivers()) or key in [step.name for step in self.steps()]:
            return problem
        return f"{problem}; {key} is not asked for here: give an answer that fits it, and change both in the file later"

    def _check_role(self, role: str) -> None:
        if self.file.parent == options.CONFIG_FOLDER and options.unit_role(self.file) != role:
            raise UserError(
                f"no unit starts {self.file} as {role}: cube and tracker are two units, on one machine too; set up"
                " each, 'heliocube setup /etc/heliocube/cube.toml' and 'heliocube setup /etc/heliocube/tracker.toml'"
            )

    def _check_key(self, name: str) -> None:
        path = self.file.parent / _expand_home(self.key_file())
        if name != NEW_KEY:
            load_key(path)
        elif path.exists():
            raise UserError(f"{path} is there already: name it, or move it away for a new one")


def _parse_answer(step: SetupStep, said: str, key: keys.Key | None) -> Answer:
    """Return the value that the typed words mean; raises `UserError`."""
    if step.optional and said.lower() in _NONE:
        return None
    if step.choices and (key is None or key.json_types == {"string"}):
        return _match_choice(step, said)
    if key is None:
        return said
    if key.json_types & {"number", "integer"}:
        number = keys.parse_quantity(said, key)
        if number is None:
            raise UserError(f"{keys.quoted(said)} is not {key.expected}")
        return int(number) if key.json_types == {"integer"} and number.is_integer() else number
    if key.json_types == {"array"}:
        items = [item for item in re.split(r"[\s,]+", said) if item]
        return [int(item) for item in items] if all(item.isdecimal() for item in items) else items
    return said


def _expand_home(said: str) -> Path:
    """Return a path with its ~ replaced by the home folder; raises `UserError` if there is no such user."""
    try:
        return Path(said).expanduser()
    except RuntimeError:
        raise UserError(f"{keys.quoted(said)}: there is no such user; write the whole path") from None


def _match_choice(step: SetupStep, said: str) -> str:
    """Return the one choice that begins with the words; raises `UserError` if there is not exactly one."""
    word = _YES.get(said.lower(), said.lower()) if step.kind == "confirm" else said.lower()
    found = [name for name in step.choices if name == word] or [name for name in step.choices if name.startswith(word)]
    if len(found) != 1:
        raise UserError(f"{keys.quoted(said)} is not among the answers: say {_join_with_or(step.choices)}")
    return found[0]


def _join_with_or(words: tuple[str, ...]) -> str:
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def _in_words(key: keys.Key) -> str:
    """Return in words what a key takes, for a person who types at a prompt and not into a file."""
    return key.expected.replace(" in quotes", "").replace('"', "").replace("a list in brackets, each item ", "")


def _values_of(file: Path) -> dict[str, Any]:
    """Return the values of a file by their path."""
    if not file.exists():
        raise UserError(f"there is no {file}: is the bench running, and is that its folder?")
    found = dict(_flat(read_tables(file), ""))
    for former in RENAMED_KEYS.keys() & found.keys():
        found[f"{former.rpartition('.')[0]}.{RENAMED_KEYS[former]}"] = found.pop(former)
    return found


def _is_paper_site_value(path: str, value: Any) -> bool:
    """Return whether a value of the site is the default, which is that of the paper's site."""
    key = keys.keys().get(path)
    return key is not None and key.section == "site" and value == key.default


def _flat(table: Mapping[str, Any], path: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in table.items():
        inner = f"{path}.{name}" if path else name
        found += _flat(value, inner) if isinstance(value, dict) else [(inner, value)]
    return found


def _tables(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return values by path as the tables of a file."""
    found: dict[str, Any] = {}
    for path, value in values.items():
        *outer, last = path.split(".")
        table = found
        for name in outer:
            table = table.setdefault(name, {})
        table[last] = value
    return found
