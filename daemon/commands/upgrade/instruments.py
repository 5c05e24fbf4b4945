"""The part of the self-check that asks the instruments themselves, when no service uses them; it moves nothing."""

import asyncio
from collections.abc import Awaitable, Callable, Iterator

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.commands.upgrade.finding import Finding
from daemon.config.plugin_sections import LOAD, MULTIPLEXED
from daemon.config.settings import Settings
from daemon.rigs.probe_cube import probe_multiplexer, probe_voltmeter
from daemon.rigs.probe_load import probe_load
from daemon.rigs.real import build_cube, build_positioner
from daemon.service.rig import Role
from drivers.errors import DeviceError
from drivers.interfaces import Telemetry
from drivers.transcript import no_tap

_WITHIN_S = 60.0

Ask = Callable[[Settings], Awaitable[tuple[str, str]]]


async def check_instruments(settings: Settings, role: Role) -> list[Finding]:
    """Return how each instrument of a role answers: opened, read once and released, one after the other.

    Nothing is sent that could move an axis. Voltmeter, multiplexer and load are asked and left as they are; a cube of
    another driver is read as the service reads it.
    """
    if not settings.real:
        return [Finding("instruments", "simulated: there is nothing to ask")]
    return [await _ask_instrument(subject, ask, own) for subject, ask, own in _instruments_of_role(settings, role)]


def _instruments_of_role(settings: Settings, role: Role) -> Iterator[tuple[str, Ask, Settings]]:
    if role is not Role.TRACKER:
        if settings.instruments.cube.driver == MULTIPLEXED:
            yield "voltmeter", _voltmeter, settings
            yield "multiplexer", _multiplexer, settings
        else:
            yield "cube", _cube, settings
    for name, own in settings.trackers if role is not Role.CUBE else ():
        of = f" of {name}" if len(settings.trackers) > 1 else ""
        yield f"positioner{of}", _positioner, own
        if own.load.driver not in LOAD.built_in:
            yield f"load{of}", _load, own


async def _ask_instrument(subject: str, ask: Ask, settings: Settings) -> Finding:
    try:
        return Finding(subject, *await asyncio.wait_for(ask(settings), _WITHIN_S))
    except TimeoutError:
        return Finding(subject, f"did not answer within {_WITHIN_S:.0f} s", "look at it with 'heliocube probe'")
    except DeviceError as error:
        return Finding(
            subject, error.message, f"cable, supply, rights, or another program that has it ({error.device})"
        )
    except UserError as error:
        return Finding(subject, str(error), "see docs/install.md")


async def _cube(settings: Settings) -> tuple[str, str]:
    cube = build_cube(settings, SystemClock())
    try:
        identity = await cube.open()
        reading = await cube.read()
    finally:
        await cube.close()
    bad = [f"{name}: {face.flaw}" for name, face in zip(FACES, reading.faces, strict=True) if face.flaw]
    return f"{identity}; {', '.join(bad) or 'all four faces answer'}", "check these sensors" if bad else ""


async def _positioner(settings: Settings) -> tuple[str, str]:
    positioner = build_positioner(settings, SystemClock())
    try:
        identity = await positioner.open()
        seen = await positioner.read_telemetry()
    finally:
        await positioner.close()
    where = f"{identity.board} {identity.firmware} at A {seen.a_deg:z.1f}, B {seen.b_deg:z.1f} deg"
    wrong = [*identity.setup_conflicts, *_concerns(seen)]
    return "; ".join([where, *wrong]), "see 'heliocube probe positioner'" if wrong else ""


def _concerns(seen: Telemetry) -> list[str]:
    concerns = [f"fault {fault}" for fault in seen.faults]
    if seen.was_reset:
        concerns.append("it has restarted, so its reference is in doubt")
    return concerns


async def _voltmeter(settings: Settings) -> tuple[str, str]:
    said: list[str] = []
    await probe_voltmeter(settings, SystemClock().monotonic, no_tap, said.append, write=False)
    return said[0], ""


async def _multiplexer(settings: Settings) -> tuple[str, str]:
    said: list[str] = []
    await probe_multiplexer(settings, no_tap, said.append, write=False)
    return said[0], ""


async def _load(settings: Settings) -> tuple[str, str]:
    said: list[str] = []
    await probe_load(settings, SystemClock().monotonic, no_tap, said.append, write=False)
    return said[0], ""
