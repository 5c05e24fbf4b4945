"""The questions of a setup in their order, as pure functions of what is known: nothing is read or written here."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from ipaddress import ip_address
from typing import Any, Literal

from daemon.base.addresses import parse_address
from daemon.base.records import FACES
from daemon.commands.setup.saved_answers import Answer
from daemon.config import keys
from daemon.config.plugin_sections import CUBE, DRIVER, LOAD, MULTIPLEXED, POSITIONER, PYRANOMETERS, PluginSection

ROLE, RIG, BENCH, KEY = "role", "rig", "bench", "key"
SUN, FACES_FIT = "sun", "faces fit"
LOOK_CUBE, LOOK_POSITIONER, LOOK_LOAD = "look at the cube", "look at the positioner", "look at the load"
MOVE, WAY, UNPLUGGED, SUPPLY = "first move", "way of the first move", "unplugged", "supply"
SLOWEST_SPEED_KEY = "instruments.positioner.slowest_deg_per_s"
BENCH_RIG = "bench"
SKIPPED = "skipped"
LATER = "later"

# Narrow limits for the first moves: docs/install.md says how they are widened.
FIRST_LIMITS: Mapping[str, float] = {
    "limits.a_min_deg": -5.0,
    "limits.a_max_deg": 5.0,
    "limits.b_min_deg": 80.0,
    "limits.b_max_deg": 90.0,
}
_ADDRESS_KEYS = ("port", "server", "line", "resource", "channels")
_OPTIONAL_KEYS = ("instruments.multiplexer.server",)
_OF_THE_SWITCH = (
    "instruments.multiplexer.digital_port",
    "instruments.multiplexer.server",
    "instruments.voltmeter.resource",
    "instruments.voltmeter.range_v",
)

Kind = Literal["key", "choice", "text", "confirm", "action"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupStep:
    """One thing that is asked or done.

    Attributes
    ----------
    name
        Name of its answer; for a key of the configuration, the key's path.
    chapter
        Heading under which it is asked.
    kind
        A `key` of the configuration; a `choice` of words; a `text`, such as a path; something to `confirm`, with yes
        and other words; an `action`, which is done or skipped.
    question
        The question, for people.
    choices
        The words of a choice or a confirmation.
    default
        What Enter takes; None if an answer has to be typed.
    optional
        Whether ``none`` is an answer.
    refusal
        The sentence that answers the word ``no``.
    remaining_task
        What is left to do if it was skipped or put off; ``{file}`` stands for the configuration.
    """

    name: str
    chapter: str
    kind: Kind
    question: str
    choices: tuple[str, ...] = ()
    default: Answer = None
    optional: bool = False
    refusal: str = ""
    remaining_task: str = ""


@dataclass(frozen=True, slots=True)
class SetupContext:
    """What the steps depend on: the answers, and by path the values of the file that is taken as the basis."""

    answers: Mapping[str, Answer]
    file_values: Mapping[str, Any]

    def role(self) -> str:
        """Return the role, ``both`` until it is answered."""
        return str(self.answers.get(ROLE, "both"))

    def driver(self, plugged: PluginSection) -> str:
        """Return the driver of a section."""
        path = f"{plugged.path}.{DRIVER}"
        return str(self.answers.get(path, self.file_values.get(path, plugged.default)))

    def chosen_drivers(self) -> keys.Drivers:
        """Return the sections of drivers, each with the name of the chosen driver."""
        return tuple((each.path, self.driver(each)) for each in (CUBE, POSITIONER, LOAD))


def plan(known: SetupContext) -> list[SetupStep]:
    """Return every step that these answers lead to, answered ones included."""
    return [
        *_machine(known),
        *_site(known),
        *_cube(known),
        *_positioner(known),
        *_load(known),
        *_bridge(known),
        *_move(known),
    ]


def _machine(known: SetupContext) -> Iterator[SetupStep]:
    chapter = "The machine"
    yield SetupStep(
        name=ROLE,
        chapter=chapter,
        kind="choice",
        question="What will this machine do: read the cube, drive the tracker, or both?",
        choices=("both", "cube", "tracker"),
        default="both",
    )
    yield SetupStep(
        name=RIG,
        chapter=chapter,
        kind="choice",
        question="Are the instruments real, or those of a running 'heliocube bench' (SIMULATED)?",
        choices=("real", BENCH_RIG),
        default="real",
    )
    if known.answers.get(RIG) == BENCH_RIG:
        yield SetupStep(
            name=BENCH,
            chapter=chapter,
            kind="text",
            question="Which folder is the bench's (heliocube bench --dir DIR)?",
        )


def _site(known: SetupContext) -> Iterator[SetupStep]:
    chapter = "The site"
    for name in ("name", "latitude_deg", "longitude_deg", "altitude_m"):
        # The paper's site is no default for a rig: whoever took it by Enter would have the sun at a wrong place.
        yield _key(known, f"site.{name}", chapter, default=None)
    yield SetupStep(
        name=SUN,
        chapter=chapter,
        kind="confirm",
        question="Does that fit the clock on the wall and the sky?",
        choices=("yes", "no"),
        default="yes",
        refusal="then a coordinate or the clock is wrong: put the clock right, or say 'back' to correct the site",
    )


def _cube(known: SetupContext) -> Iterator[SetupStep]:
    chapter = "The cube"
    if known.role() == "tracker":
        yield _key(known, "cube.scan_every_s", chapter)
        return
    yield _driver(known, CUBE, chapter)
    driver = known.driver(CUBE)
    if driver == MULTIPLEXED:
        for path in _OF_THE_SWITCH:
            yield _key(known, path, chapter)
    yield from _addresses(known, CUBE, chapter)
    for face in FACES:
        if driver == MULTIPLEXED:
            yield _key(known, f"cube.{face}.channel", chapter)
        if driver != PYRANOMETERS:
            yield _key(known, f"cube.{face}.gain_w_m2_per_mv", chapter)
    yield SetupStep(
        name=LOOK_CUBE,
        chapter=chapter,
        kind="action",
        question="Read the four faces now: this moves nothing.",
        remaining_task="read the cube: heliocube probe, with --config {file}: docs/hardware.md",
    )
    if known.answers.get(LOOK_CUBE) not in (None, SKIPPED):
        yield SetupStep(
            name=FACES_FIT,
            chapter=chapter,
            kind="confirm",
            question="Do they look like the sky? Shade one face: its number must fall, and no other.",
            choices=("yes", LATER, "no"),
            default=LATER,
            remaining_task="shade one face after the other and see its number fall, and no other",
            refusal="then an input or a wire belongs to another face: say 'back' to read the faces again or to correct"
            " the inputs",
        )


def _positioner(known: SetupContext) -> Iterator[SetupStep]:
    if known.role() == "cube":
        return
    chapter = "The positioner"
    yield _driver(known, POSITIONER, chapter)
    yield from _addresses(known, POSITIONER, chapter)
    yield SetupStep(
        name=LOOK_POSITIONER,
        chapter=chapter,
        kind="action",
        question="Listen to it now: nothing is sent that could move an axis.",
        remaining_task="listen to the positioner: heliocube probe positioner --config {file}",
    )


def _load(known: SetupContext) -> Iterator[SetupStep]:
    if known.role() == "cube":
        return
    chapter = "The electronic load"
    real = tuple(name for name in LOAD.names() if name != "simulated")
    yield _driver(known, LOAD, chapter, real)
    if known.driver(LOAD) not in LOAD.built_in:
        yield from _addresses(known, LOAD, chapter)
        yield SetupStep(
            name=LOOK_LOAD,
            chapter=chapter,
            kind="action",
            question="Read its identity now: its input stays as it is.",
            remaining_task="look at the electronic load: heliocube probe load --config {file}",
        )


def _bridge(known: SetupContext) -> Iterator[SetupStep]:
    chapter = "The way from cube to tracker"
    if known.role() == "cube":
        send_to = _key(known, "bridge.send_to", chapter)
        grouped = known.file_values.get("bridge.multicast_group") is not None
        yield send_to if grouped or not _is_wrongly_local(known, send_to) else replace(send_to, default=None)
    if known.role() == "tracker":
        listen = _key(known, "bridge.listen", chapter, default="0.0.0.0:20571")
        every = f"0.0.0.0:{parse_address(str(listen.default)).port}"
        yield replace(listen, default=every) if _is_wrongly_local(known, listen) else listen
    if known.role() != "both":
        yield SetupStep(
            name=KEY,
            chapter=chapter,
            kind="text",
            question="Which file has the key that both machines share? 'new' makes one.",
            default=_text(known.file_values.get("bridge.key_file")) or ("new" if known.role() == "cube" else None),
        )


def _is_wrongly_local(known: SetupContext, step: SetupStep) -> bool:
    """Return whether the offered address would keep scans on this machine, though cube and tracker are on two machines.

    An installation, or an earlier setup, may have left such an address. A bench is on one machine: there it is right.
    """
    if known.answers.get(RIG) == BENCH_RIG or known.file_values.get("bridge.transport") == "mqtt":
        return False
    addresses = step.default if isinstance(step.default, list) else [step.default]
    return all(ip_address(parse_address(str(text)).host).is_loopback for text in addresses)


def _move(known: SetupContext) -> Iterator[SetupStep]:
    if known.role() == "cube":
        return
    chapter = "Limits and wind"
    for path, narrow in FIRST_LIMITS.items():
        yield _key(known, path, chapter, default=narrow)
    yield _key(known, "safety.stow_wind_m_s", chapter)
    yield _key(known, "safety.release_wind_m_s", chapter)
    yield _key(known, "safety.without_wind_source", chapter)
    chapter = "The first move"
    yield SetupStep(
        name=MOVE,
        chapter=chapter,
        kind="action",
        question="",
        remaining_task="THE FIRST MOVE, with a hand on the stop: docs/install.md, section 7",
    )
    done = known.answers.get(MOVE)
    if done is None or done == SKIPPED:
        return
    yield SetupStep(
        name=WAY,
        chapter=chapter,
        kind="confirm",
        question="Did each of these moves go in the direction named above, as seen by the person at the mechanics?",
        choices=("yes", "no"),
        refusal="then the axes are swapped or reversed: leave with Ctrl-C, switch the motors' supply off, and see"
        " docs/hardware.md; 'back' makes the move once more",
    )
    if isinstance(done, float):
        # Half of the measured speed, as docs/hardware.md says.
        half = _key(known, SLOWEST_SPEED_KEY, chapter, default=float(f"{done / 2:.2g}"))
        yield replace(half, question=f"{half.question} Half of the {done:.2f} deg/s just seen is right.")
    for name, question in (
        (UNPLUGGED, "with the USB plug pulled in a move, the axis goes on to its end"),
        (SUPPLY, "with the motors' supply off and on again, the position is kept"),
    ):
        yield SetupStep(
            name=name,
            chapter=chapter,
            kind="confirm",
            question=f"See this once, now or later: {question}.",
            choices=("yes", LATER),
            default=LATER,
            remaining_task=question,
        )


def _driver(
    known: SetupContext, plugged: PluginSection, chapter: str, names: tuple[str, ...] | None = None
) -> SetupStep:
    path = f"{plugged.path}.{DRIVER}"
    default = str(known.file_values.get(path, plugged.default))
    return SetupStep(
        name=path,
        chapter=chapter,
        kind="choice",
        question=plugged.title,
        choices=names or plugged.names(),
        default=default,
    )


def _addresses(known: SetupContext, plugged: PluginSection, chapter: str) -> Iterator[SetupStep]:
    """Yield the keys that say where the instrument of the chosen driver is, whichever driver that is."""
    for key in keys.keys(known.chosen_drivers()).values():
        if key.section == plugged.path and key.name in _ADDRESS_KEYS and not key.only_for:
            yield _key(known, key.path, chapter)


def _key(known: SetupContext, path: str, chapter: str, **given: Answer) -> SetupStep:
    key = keys.keys(known.chosen_drivers())[path]
    found = known.file_values.get(path, given.get("default", key.default))
    if path in FIRST_LIMITS or path == SLOWEST_SPEED_KEY:
        found = given["default"]
    return SetupStep(
        name=path,
        chapter=chapter,
        kind="key",
        question=key.description,
        choices=tuple(key.enum_values),
        default=list(found) if isinstance(found, tuple) else found,
        optional=path in _OPTIONAL_KEYS,
    )


def _text(value: object) -> str | None:
    return None if value is None else str(value)
