"""The names that `heliocube energy` takes, checked before scientific libraries are loaded."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from types import ModuleType
from typing import NamedTuple

from pydantic import ValidationError

from daemon.base import plugins
from daemon.base.errors import UserError
from daemon.config.section import describe_error
from drivers.numbers import read_number
from solar.energy import SKIES
from solar.laws.law import LawSettings

FIXED, BOUND = "fixed", "bound"
"""Two that are no laws but are compared with them: a plane of some tilt that never moves, and the bound."""
LOSSES_LAW = "optimal"
"""The law whose losses can be told by cause: no other has a price and an expectation that can be taken away."""


def check_names(skies: Sequence[str], law_names: Sequence[str]) -> None:
    """Raise `UserError` for a sky or law that does not exist, and for an empty list."""
    if not skies:
        raise UserError(f"--sky: name at least one of {', '.join(SKIES)}")
    if not law_names:
        raise UserError(f"--laws: name at least one of {', '.join(default_names())}")
    for name in skies:
        if name not in SKIES:
            raise UserError(f"--sky: there is no sky '{name}'; choose from {', '.join(SKIES)}")
    for name in law_names:
        parse_law(name)


def check_laws_of_losses(law_names: Sequence[str]) -> None:
    """Raise `UserError` for a law whose losses cannot be told apart."""
    for name in law_names:
        if name.partition(":")[0] != LOSSES_LAW:
            raise UserError(f"--losses is for {LOSSES_LAW} and {LOSSES_LAW}:THRIFT only, not for {name}")


def default_names() -> tuple[str, ...]:
    """Return a fixed plane, every law that is installed, and the bound."""
    return (f"{FIXED}:35", *plugins.names(plugins.LAWS), BOUND)


class AskedLaw(NamedTuple):
    """A law with its settings, or a plane of some tilt that never moves; neither for the bound."""

    law: ModuleType | None = None
    settings: LawSettings | None = None
    tilt_deg: float | None = None


def parse_law(name: str) -> AskedLaw:
    """Return what a name of the command line means; `UserError` for a name that does not exist."""
    if name == BOUND:
        return AskedLaw()
    law, colon, text = name.partition(":")
    try:
        if law == FIXED:
            tilt_deg = read_number(text)
            if 0.0 <= tilt_deg <= 90.0:
                return AskedLaw(tilt_deg=tilt_deg)
        elif law in plugins.names(plugins.LAWS):
            module = plugins.load(plugins.LAWS, law)
            if not colon:
                return AskedLaw(module, module.SETTINGS())
            if module.SETTINGS.knob is not None:
                return AskedLaw(module, module.SETTINGS(**{module.SETTINGS.knob: read_number(text)}))
    except ValidationError as error:
        raise UserError(f"--laws: {name}: {describe_error(error.errors()[0])}") from None
    except ValueError:
        pass
    known = ", ".join((f"{FIXED}:DEG", *plugins.names(plugins.LAWS), BOUND))
    knobs = [f"{each}:{module.SETTINGS.knob.upper()}" for each, module in _laws() if module.SETTINGS.knob is not None]
    raise UserError(f"--laws: there is no law '{name}'; choose from {known}, {', '.join(knobs)}, DEG in 0..90")


def _laws() -> Iterator[tuple[str, ModuleType]]:
    for name in plugins.names(plugins.LAWS):
        # A law that nobody has asked for may be broken.
        with suppress(plugins.PluginError):
            yield name, plugins.load(plugins.LAWS, name)
