"""The simulated Keithley 2000 voltmeter: bytes in, replies with their due times out, time as an argument.

The pace of the serial line is left out: the host sees to it.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from sim_drivers.scpi import ScpiError
from sim_drivers.voltmeter.commands import TABLE, Step, compile_line
from sim_drivers.voltmeter.instrument import VoltmeterInstrument

INPUT_LIMIT = 2048
DEFAULT_IDENTITY = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02"
TERMINATORS = {"LF": b"\n", "CR": b"\r", "LFCR": b"\n\r"}
_ABORTS = b"\x03\x18"
_ENDS = b"\n\r"
_CACHED_LINES = 256


class VoltmeterCore(VoltmeterInstrument):
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
        Grows when the meter drops output that was not yet due (control-C, power-cycle): its host must drop it too.
    table
        The commands that it knows.
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
        super().__init__(input_voltage, random, line_frequency_hz=line_frequency_hz, identity=identity, now=now)
        self.table = TABLE
        self.aborts = 0
        self.mute = False
        self.reply_delay_s = 0.0
        self._terminator = TERMINATORS[terminator]
        self._random = random
        self._programs: dict[bytes, tuple[Step, ...]] = {}
        self._buffer = bytearray()
        self._overrun = False
        self._rest = b""
        self._drops = self._corruptions = self._cuts = 0

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
                self._take_byte(byte)
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

    def cut_next(self, count: int = 1) -> None:
        """Lose the second half of each of the next replies, its end with it."""
        self._cuts += count

    def power_cycle(self, now: float) -> None:
        """Switch off and on: defaults, free-running, the power-on mark set, everything under way forgotten."""
        self._buffer.clear()
        self._overrun = False
        self._power_up(now)
        self.aborts += 1

    def _take_byte(self, byte: int) -> None:
        if self._overrun:
            return
        self._buffer.append(byte)
        if len(self._buffer) > INPUT_LIMIT:
            self._overrun = True
            self.status.fail(-363)

    def _compiled(self, line: bytes) -> tuple[Step, ...]:
        program = compile_line(line.decode("latin-1"), self.table)
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
        if self._cuts:
            self._cuts -= 1
            self._rest += data[: len(data) // 2]
            return []
        # Without its end half a line is the beginning of the next one.
        data, self._rest = self._rest + data, b""
        return [(self._cursor_s + self.reply_delay_s, data + self._terminator)]

    def _drop_output(self, now: float) -> None:
        self._buffer.clear()
        self._rest = b""
        self._overrun = False
        self._now = now
        self.abort()
        self.aborts += 1
