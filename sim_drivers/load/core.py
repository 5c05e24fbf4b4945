"""The simulated electronic load: bytes in, replies with their due times out, time as an argument.

The pace of the line is left out: the host sees to it.
"""

import numpy as np

from sim_drivers.load.commands import Program, compile_line
from sim_drivers.load.dialects import DialectName
from sim_drivers.load.instrument import LoadInstrument, Source
from sim_drivers.scpi import ScpiError

MEASURING_S = 0.004
INPUT_LIMIT = 1024
_ABORT = 0x03
_ENDS = b"\n\r"
_CACHED_LINES = 512


class LoadCore(LoadInstrument):
    """The instrument behind its line.

    Parameters
    ----------
    source
        What feeds it.
    random
        For the noise of readings and for corrupted replies.
    make
        Whose commands it speaks.
    channel
        Which channel of a mainframe the source is on; of no meaning for a load with one.
    one_question
        Answer only the first question of a line.
    now
        The time of power-up, with the input off.

    Attributes
    ----------
    aborts
        Grows when output that was not yet due is dropped (device clear, which control-C stands for; power-cycle).
    """

    def __init__(
        self,
        source: Source,
        random: np.random.Generator,
        *,
        make: DialectName = "chroma63600",
        channel: int = 1,
        one_question: bool = False,
        now: float = 0.0,
    ) -> None:
        super().__init__(source, random, make=make, channel=channel, now=now)
        self.one_question = one_question
        self.aborts = 0
        self._programs: dict[bytes, Program] = {}
        self._drops = self._corruptions = 0
        self._buffer = bytearray()

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it is complete."""
        if not self._buffer and (program := self._programs.get(data)):
            return self._execute(program, now)
        replies = []
        for byte in data:
            if byte == _ABORT:
                self._buffer.clear()
                self.aborts += 1
            elif byte not in _ENDS:
                if len(self._buffer) < INPUT_LIMIT:
                    self._buffer.append(byte)
            elif self._buffer:
                line = bytes(self._buffer)
                self._buffer.clear()
                replies += self._run(line, now)
        return replies

    def drop_next(self, count: int = 1) -> None:
        """Lose the next replies."""
        self._drops += count

    def corrupt_next(self, count: int = 1) -> None:
        """Garble one byte of each of the next replies."""
        self._corruptions += count

    def power_cycle(self, now: float) -> None:
        """Switch off and on: input off, protections cleared, everything under way forgotten."""
        self._buffer.clear()
        self.aborts += 1
        self._power_up(now)

    def _run(self, line: bytes, now: float) -> list[tuple[float, bytes]]:
        program = self._programs.get(line)
        if program is None:
            if len(self._programs) >= _CACHED_LINES:
                self._programs.clear()
            program = compile_line(line.decode("latin-1"), self.make)
            # Also with its end, so that `feed` finds a line that comes as one piece at once.
            self._programs[line] = self._programs[line + b"\n"] = program
        return self._execute(program, now)

    def _execute(self, program: Program, now: float) -> list[tuple[float, bytes]]:
        due_s = now
        answers: list[str] = []
        try:
            for step in program:
                answer = step(self, due_s)
                if answer is None:
                    continue
                if answers and self.one_question:
                    self.scpi.fail(-113)
                    break
                due_s += MEASURING_S
                answers.append(answer)
        except ScpiError as error:
            self.scpi.fail(error.code)
        return self._emit(";".join(answers), due_s) if answers else []

    def _emit(self, text: str, due_s: float) -> list[tuple[float, bytes]]:
        if self._drops:
            self._drops -= 1
            return []
        data = bytearray(text.encode("latin-1"))
        if self._corruptions:
            self._corruptions -= 1
            data[int(self._random.integers(len(data)))] ^= 0x40
        return [(due_s, bytes(data) + self.dialect.end)]
