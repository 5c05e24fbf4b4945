"""The simulated Keithley 2000 voltmeter: bytes in, replies with their due times out, time as an argument.

Left out: functions other than DC voltage (they can be selected and read about zero), the reading buffer, and the pace
of the serial line, which is the host's matter.
"""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np

from sim_drivers.scpi import ScpiError, Status
from sim_drivers.voltmeter.commands import PRESET, RANGES_V, Settings, Step, compile_line
from sim_drivers.voltmeter.converter import Converter

INPUT_LIMIT = 2048
DEFAULT_IDENTITY = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02"
TERMINATORS = {"LF": b"\n", "CR": b"\r", "LFCR": b"\n\r"}
_ABORTS = b"\x03\x18"
_ENDS = b"\n\r"
_CACHED_LINES = 256
_MAXIMUM_READINGS = 1024


class VoltmeterCore:
    """The instrument behind its serial or GPIB line.

    Parameters
    ----------
    input_voltage
        What is at the terminals [V], of time [s]. It is asked for the middle of a conversion.
    random
        For the noise and for corrupted replies.
    line_frequency_hz
        Detected at power-up; sets the length of a power line cycle.
    terminator
        What ends a reply, as chosen on the front panel; LF and CR both end a command.
    now
        The time of power-up, from which the meter measures freely.

    Attributes
    ----------
    aborts
        Grows when the meter drops output that was not yet due (control-C, power-cycle): so must its host.
    mute
        While true no reply comes.
    reply_delay_s
        Added to the due time of every reply.
    """

    def __init__(
        self,
        input_voltage: Callable[[float], float],
        random: np.random.Generator,
        *,
        line_frequency_hz: float = 50.0,
        terminator: Literal["LF", "CR", "LFCR"] = "LF",
        identity: str = DEFAULT_IDENTITY,
        now: float = 0.0,
    ) -> None:
        if not (45.0 <= line_frequency_hz <= 440.0):
            raise ValueError(f"the line frequency must be 45 to 440 Hz, not {line_frequency_hz}")
        self.identity: str = identity
        self.settings: Settings = PRESET
        self.status: Status = Status()
        self.aborts = 0
        self.mute = False
        self.reply_delay_s = 0.0
        self._terminator = TERMINATORS[terminator]
        self._random = random
        self._converter = Converter(input_voltage, random, 1.0 / line_frequency_hz)
        self._programs: dict[bytes, tuple[Step, ...]] = {}
        self._buffer = bytearray()
        self._overrun = False
        self._drops = self._corruptions = 0
        self._now = self._cursor_s = self._ready_s = self._free_since_s = now
        self._free_index = 0
        self._awaits_trigger = False
        self._last: str | None = None
        self._power_up(now)

    @property
    def range_v(self) -> float:
        """The range in use [V]."""
        return self._converter.range_v

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it is complete."""
        if not self._buffer:
            program = self._programs.get(data)
            if program is not None:
                return self._run(program, now)
        replies = []
        for byte in data:
            if byte in _ABORTS:
                self._drop_output(now)
            elif byte not in _ENDS:
                self._take(byte)
            elif self._buffer:
                line = bytes(self._buffer)
                self._buffer.clear()
                if not self._overrun:
                    replies += self._run(self._compiled(line), now)
                self._overrun = False
        return replies

    def drop_next(self, count: int = 1) -> None:
        """Lose the next replies."""
        self._drops += count

    def corrupt_next(self, count: int = 1) -> None:
        """Garble one byte of each of the next replies."""
        self._corruptions += count

    def press_range(self, range_v: float, now: float) -> None:
        """Choose a range at the front panel, which does nothing while the panel is locked out."""
        if range_v not in RANGES_V:
            raise ValueError(f"the meter has the ranges {RANGES_V} V, not {range_v}")
        if self.settings.panel != "RWL":
            self.change(now, range_v=range_v, autorange=False)

    def power_cycle(self, now: float) -> None:
        """Switch off and on: defaults, free-running, the power-on mark set, everything under way forgotten."""
        self._power_up(now)
        self.aborts += 1

    def change(self, now: float, **settings: Any) -> None:
        """Apply settings as a command does; free running starts anew."""
        self.settings = replace(self.settings, **settings)
        self._converter.configure(self.settings, now)
        self._free_since_s, self._free_index = now, 0

    def read(self, cursor_s: float) -> str | None:
        """Measure and answer; None while a trigger has to come first."""
        self.initiate(cursor_s)
        return None if self._awaits_trigger else self._last

    def initiate(self, cursor_s: float) -> None:
        """Leave idle for the programmed number of readings."""
        if self.settings.continuous:
            raise ScpiError(-213)
        if self.settings.trigger_source in ("IMM", "TIM"):
            self._measure(cursor_s)
        else:
            self._awaits_trigger = True

    def trigger(self, cursor_s: float) -> None:
        """Take a trigger from the bus."""
        if self._awaits_trigger and self.settings.trigger_source == "BUS":
            self._awaits_trigger = False
            self._measure(cursor_s)

    def fetch(self, cursor_s: float) -> str:
        """Answer with the latest reading."""
        if self.settings.continuous:
            self._catch_up(cursor_s)
        if self._last is None or self._awaits_trigger:
            raise ScpiError(-230)
        return self._last

    def abort(self) -> None:
        """Go back to idle at once."""
        self._awaits_trigger = False
        self._ready_s = self._cursor_s = self._now

    def reset(self, settings: Settings) -> None:
        """Take all settings from ``*RST`` or from the bench defaults; the front panel stays as it is."""
        self.abort()
        self._last = None
        chosen = {field.name: getattr(settings, field.name) for field in fields(settings)}
        self.change(self._now, **(chosen | {"panel": self.settings.panel}))

    def status_byte(self) -> int:
        """Return the status byte under the present masks."""
        return self.status.byte(self.settings.event_enable, self.settings.request_enable)

    def _power_up(self, now: float) -> None:
        self.settings = PRESET
        self.status = Status()
        self._buffer.clear()
        self._overrun = False
        self._now = now
        self.reset(PRESET)

    def _take(self, byte: int) -> None:
        if self._overrun:
            return
        self._buffer.append(byte)
        if len(self._buffer) > INPUT_LIMIT:
            self._overrun = True
            self.status.fail(-363)

    def _compiled(self, line: bytes) -> tuple[Step, ...]:
        program = compile_line(line.decode("latin-1"))
        if len(self._programs) >= _CACHED_LINES:
            self._programs.clear()
        # Found again when the same line comes as one piece with the usual end.
        self._programs[line + b"\n"] = self._programs[line + b"\r"] = program
        return program

    def _run(self, program: tuple[Step, ...], now: float) -> list[tuple[float, bytes]]:
        self._now = now
        # While something is being measured a command waits until it is done.
        self._cursor_s = max(now, self._ready_s)
        answers = []
        try:
            for step in program:
                answer = step(self, self._cursor_s)
                if answer is not None:
                    answers.append(answer)
        except ScpiError as error:
            self.status.fail(error.code)
        self._ready_s = self._cursor_s
        return self._emit(";".join(answers)) if answers else []

    def _emit(self, text: str) -> list[tuple[float, bytes]]:
        if self.mute:
            return []
        if self._drops:
            self._drops -= 1
            return []
        data = text.encode("latin-1")
        if self._corruptions:
            self._corruptions -= 1
            garbled = bytearray(data)
            garbled[int(self._random.integers(len(garbled)))] ^= 0x40
            data = bytes(garbled)
        return [(self._cursor_s + self.reply_delay_s, data + self._terminator)]

    def _drop_output(self, now: float) -> None:
        self._buffer.clear()
        self._overrun = False
        self._now = now
        self.abort()
        self.aborts += 1

    def _measure(self, cursor_s: float) -> None:
        count = min(self.settings.sample_count * self.settings.trigger_count, _MAXIMUM_READINGS)
        readings = []
        for _ in range(count):
            reading, cursor_s = self._converter.convert(cursor_s)
            readings.append(reading)
        self._last = ",".join(readings)
        self._cursor_s = cursor_s

    def _catch_up(self, cursor_s: float) -> None:
        # Readings of free running that nobody fetches are never computed; the first one is waited for.
        period_s = self._converter.conversion_s
        index = max(math.floor((cursor_s - self._free_since_s) / period_s), 1)
        if index > self._free_index:
            self._free_index = index
            self._last, end_s = self._converter.convert(self._free_since_s + (index - 1) * period_s)
            self._cursor_s = max(cursor_s, end_s)
