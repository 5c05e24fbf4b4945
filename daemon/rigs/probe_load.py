"""The probe of a real electronic load."""

from collections.abc import Callable, Sequence
from typing import Any

from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.real import build_load
from drivers.errors import ConnectError, DeadlineError
from drivers.load import agilent6063b, chroma63600
from drivers.load.connection import load_line
from drivers.load.session import Dialect
from drivers.scpi import ScpiLine
from drivers.settings import SettingsError
from drivers.transcript import Tap
from solar.iv import measured_maximum, sweep_voltages


async def probe_load(
    settings: Settings, now: Callable[[], float], tap: Tap, say: Callable[[str], object], *, write: bool
) -> dict[str, Any]:
    """Ask the load who it is and how it is set; with `write`, trace one curve and leave the module in open circuit.

    Parameters
    ----------
    settings
        Which load, and where it is.
    now
        Monotonic time [s].
    tap
        Called with all bytes on the line.
    say
        Takes the lines of the report.

    Returns
    -------
    dict
        For scripts: `answers` by name, and with `write` the `curve` [V, A] and its maximum [W].

    Raises
    ------
    UserError
        The settings do not say which load it is, or where.
    DeviceError
        The load cannot be reached, or does not do as it should.
    """
    own = settings.load
    if isinstance(own, chroma63600.ChromaSettings):
        dialect = chroma63600.dialect(own.channel)
    elif isinstance(own, agilent6063b.AgilentSettings):
        dialect = agilent6063b.DIALECT
    else:
        raise UserError('load.driver names no load that can be probed; give --driver, "chroma63600" or "agilent6063b"')
    try:
        line = load_line(own, tap)
    except SettingsError as error:
        raise UserError(str(error)) from None

    try:
        await line.open()
        await line.interrupt()
        await line.drain(0.1)
        answers = await _answers(line, dialect, own.deadline_s)
    finally:
        await line.close()
    known = dialect.matches_identity(answers["identity"])
    for name, answer in answers.items():
        say(f"{name}: {answer}")
        if name == "identity" and not known:
            say(f"  this is not a {dialect.name}: the service will not use it")
    page = {"answers": answers, "known": known}
    return page | await _trace(settings, now, tap, say) if write else page


async def _answers(line: ScpiLine, dialect: Dialect, deadline_s: float) -> dict[str, str]:
    async def ask(query: str) -> str | None:
        try:
            return (await line.ask(query, deadline_s)).strip()
        except DeadlineError:
            return None

    identity = await ask("*IDN?")
    if identity is None:
        raise ConnectError(
            "load", f"does not answer *IDN? within {deadline_s:g} s; is it on, and set to this interface?"
        )
    questions = {"input on": dialect.on_query, "mode": dialect.mode_proof[0], "all in one line": dialect.measure}
    if dialect.select_proof is not None:
        questions = {"channel": dialect.select_proof[0], "module": dialect.identify_channel} | questions
    return {"identity": identity} | {name: await ask(query) or "no answer" for name, query in questions.items()}


async def _trace(
    settings: Settings, now: Callable[[], float], tap: Tap, say: Callable[[str], object]
) -> dict[str, Any]:
    load, least_v = build_load(settings, tap), settings.load.minimum_voltage_v
    assert load is not None  # noqa: S101 - narrowing; the driver was looked at before

    def plan(open_circuit_v: float) -> Sequence[float]:
        say(f"open circuit: {open_circuit_v:.3f} V")
        enough = open_circuit_v >= 2 * least_v
        return [float(each) for each in sweep_voltages(open_circuit_v, least_v, settings.load.points)] if enough else ()

    try:
        await load.open()
        start_s = now()
        swept = await load.sweep(plan, lambda: None)
        say(f"{len(swept.voltage_v)} points in {now() - start_s:.2f} s; the input is off again")
        for voltage_v, current_a in zip(swept.voltage_v, swept.current_a, strict=True):
            say(f"  {voltage_v:8.3f} V  {current_a:8.4f} A")
        if swept.stopped_why:
            say(f"stopped: {swept.stopped_why}")
        found = measured_maximum(swept.voltage_v, swept.current_a)
        say(found.why_not or f"maximum power {found.pmpp_w:.2f} +- {found.pmpp_sigma_w:.2f} W at {found.vmpp_v:.2f} V")
        return {
            "curve": {"voltage_v": swept.voltage_v, "current_a": swept.current_a},
            "stopped": swept.stopped_why or None,
            "maximum": found,
        }
    finally:
        await load.close()
