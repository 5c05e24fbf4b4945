"""Probes of the real voltmeter and multiplexer: their answers, and the checks that docs/hardware.md asks for."""

import asyncio
from collections.abc import Callable
from typing import Any

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.plugin_sections import MULTIPLEXED
from daemon.config.rules import SELF_TESTS
from daemon.config.settings import Settings
from daemon.cube.calibration import calibrated_irradiance
from daemon.rigs.real import build_multiplexer, build_voltmeter, voltmeter_line
from drivers.errors import ConnectError, DeadlineError, OverRangeError
from drivers.meters.keithley2000 import Keithley2000, require_model
from drivers.scpi import ScpiLine
from drivers.transcript import Tap

Say = Callable[[str], object]

_READINGS = 10
_SETTINGS = {
    "error queue": ":SYST:ERR?",
    "function": ":SENS:FUNC?",
    "range": ":SENS:VOLT:DC:RANG?",
    "integration": ":SENS:VOLT:DC:NPLC?",
    "filter": ":SENS:VOLT:DC:AVER:STAT?",
    "relative": ":SENS:VOLT:DC:REF:STAT?",
    "math": ":CALC1:STAT?",
    "autozero": ":SYST:AZER:STAT?",
    "free running": ":INIT:CONT?",
    "reading format": ":FORM:ELEM?",
}


async def probe_voltmeter(
    settings: Settings, now: Callable[[], float], tap: Tap, say: Say, *, write: bool
) -> dict[str, Any]:
    """Ask the voltmeter who it is and how it is set; with `write`, configure it and time some readings.

    Parameters
    ----------
    settings
        Settings that say where the voltmeter is.
    now
        Monotonic time [s].
    tap
        Called with all bytes on the line.
    say
        Takes the lines of the report.

    Returns
    -------
    dict
        For scripts: answers by name under `answers`, and the readings [mV] with the time each took [ms].

    Raises
    ------
    UserError
        The configured cube has no voltmeter.
    DeviceError
        The voltmeter cannot be reached, or does not do as it should.
    """
    _require_multiplexed(settings, "a voltmeter")
    line = voltmeter_line(settings, tap)
    try:
        await line.open()
        await line.interrupt()
        await line.drain(0.1)
        answers = await _answers(line, settings.cube.reading_deadline_s)
    finally:
        await line.close()
    for name, answer in answers.items():
        say(f"{name}: {answer}")
    require_model(answers["identity"])
    readings: list[dict[str, float]] = []
    page = {"answers": answers, "readings": readings}
    if not write:
        return page
    meter = build_voltmeter(settings, tap)
    try:
        await meter.open()
        say("configured for DC voltage, and the configuration read back")
        for _ in range(_READINGS):
            start_s = now()
            voltage_v = await meter.read_voltage()
            took_ms = (now() - start_s) * 1e3
            readings.append({"mv": voltage_v * 1e3, "took_ms": took_ms})
            say(f"  {voltage_v * 1e3:+z.4f} mV in {took_ms:.0f} ms")
    finally:
        await meter.close()
    return page


def _require_multiplexed(settings: Settings, what: str) -> None:
    driver = settings.instruments.cube.driver
    if driver != MULTIPLEXED:
        raise UserError(f'instruments.cube.driver is "{driver}": only the cube "{MULTIPLEXED}" has {what} to look at')


async def _answers(line: ScpiLine, deadline_s: float) -> dict[str, str]:
    async def ask(query: str) -> str | None:
        try:
            return (await line.ask(query, deadline_s)).strip()
        except DeadlineError:
            return None

    identity = await ask("*IDN?")
    if identity is None:
        raise ConnectError(
            "voltmeter",
            f"does not answer *IDN? within {deadline_s:g} s; is it on, and set to this interface and speed?",
        )
    return {"identity": identity} | {name: await ask(query) or "no answer" for name, query in _SETTINGS.items()}


async def probe_multiplexer(settings: Settings, tap: Tap, say: Say, *, write: bool) -> dict[str, Any]:
    """Reserve the multiplexer's lines; with `write`, select each input, and measure it if there is a voltmeter.

    Returns, for scripts, the identity that was found, and each input with its use and its reading.

    Raises
    ------
    UserError
        The configured cube has no multiplexer.
    DeviceError
        The multiplexer cannot be reached, or does not do as it should.
    """
    _require_multiplexed(settings, "a multiplexer")
    multiplexer = build_multiplexer(settings, tap)
    meter = build_voltmeter(settings) if write and settings.instruments.voltmeter.resource else None
    try:
        identity = await multiplexer.open()
        say(f"found: {identity}")
        if not write:
            return {"found": identity, "inputs": []}
        if meter is None:
            say("instruments.voltmeter.resource is not set: the inputs are selected, not measured")
        else:
            say(f"measured with {await meter.open()}")
        wired = {getattr(settings.cube, name).channel: name for name in FACES}
        for name in SELF_TESTS:
            if (channel := getattr(settings.cube, name)) is not None:
                wired[channel] = "self-test"
        inputs = []
        for channel in range(len(settings.instruments.multiplexer.addresses)):
            await multiplexer.select(channel)
            await asyncio.sleep(settings.instruments.multiplexer.settle_s)
            reading, mv = (
                ("selected", None) if meter is None else await _measure_input(meter, settings, wired.get(channel))
            )
            inputs.append({"input": channel, "for": wired.get(channel), "mv": mv, "reading": reading})
            say(f"  input {channel} ({wired.get(channel, 'not used')}): {reading}")
        return {"found": identity, "inputs": inputs}
    finally:
        await multiplexer.close()
        if meter is not None:
            await meter.close()


async def _measure_input(meter: Keithley2000, settings: Settings, name: str | None) -> tuple[str, float | None]:
    try:
        voltage_mv = await meter.read_voltage() * 1e3
    except OverRangeError:
        return "beyond the range", None
    if name not in FACES:
        return f"{voltage_mv:+z.4f} mV", voltage_mv
    return (
        f"{voltage_mv:+z.4f} mV, {calibrated_irradiance(voltage_mv, getattr(settings.cube, name)):z.1f} W/m2",
        voltage_mv,
    )
