"""One pyranometer on its line: read once a scan, proven to be the one it should be, left alone while it is dead."""

import math
from collections.abc import Callable

from drivers.cube.pyranometers.makes import Block, Make, Words, WrongSensorError
from drivers.errors import DeadlineError, RefusedError, UnavailableError
from drivers.interfaces import FaceFlaw, FaceSample
from drivers.modbus.client import ModbusBus

# After a lost reply the next scan asks again; a sensor that stays silent is asked ever more rarely.
_MISSES_BEFORE_PAUSE = 2
_FIRST_PAUSE_S = 5.0
_LONGEST_PAUSE_S = 30.0
# After so many failures in a row people are told of the sensor.
_MISSES_BEFORE_NOTE = 3


class BusSensor:
    """A sensor.

    Parameters
    ----------
    face
        Which face it is.
    unit
        Its address.
    make
        Its registers.
    pinned
        The serial number that it must have, or None.
    bus
        Its line.
    within_s
        Longest wait for an answer; after the first that does not come nothing more is asked in this scan.
    utc_s, monotonic_s
        Return the service's time.

    Attributes
    ----------
    note
        What people should know of it; empty while all is well.
    answers
        Whether it has answered when it was last asked.
    identity
        Who it is; empty while that is not known.
    same_address_sensors
        Others at the same address, as at a logger: on RTU a late reply for this sensor looks like one for them.
    """

    def __init__(
        self,
        face: str,
        unit: int,
        make: Make,
        pinned: int | None,
        bus: ModbusBus,
        within_s: float,
        utc_s: Callable[[], float],
        monotonic_s: Callable[[], float],
    ) -> None:
        self._face = face
        self.unit = unit
        self._make = make
        self._pinned = pinned
        self._bus = bus
        self._within_s = within_s
        self._utc_s = utc_s
        self._now = monotonic_s
        self._flaw: FaceFlaw = "late"
        self.same_address_sensors: tuple[BusSensor, ...] = ()
        self.begin()

    def begin(self) -> None:
        """Forget what an earlier connection has taught."""
        self.doubt()
        self._misses, self._ask_again_s = 0, -math.inf
        self.note, self.identity, self.answers = "", "", False

    def doubt(self) -> None:
        """Believe nothing before a reply that cannot be a late one."""
        proof = self._make.proof
        self._proven = False
        self._doubtful = proof is None or proof.length == self._make.data.length

    async def read(self, *, check: bool) -> FaceSample:
        """Return what it tells; with `check` its serial number is compared anew. Raises `LinkLostError` alone."""
        if self._now() < self._ask_again_s:
            return self._sample_without_value(self._flaw)
        try:
            return await self._ask(check=check)
        except UnavailableError as error:
            return self._note_miss("missing", f"does not answer: {error.message}")
        except DeadlineError as error:
            text = f"answers, but {error.message}" if error.message else "does not answer"
            return self._note_miss("missing" if error.message else "late", text)
        except RefusedError as error:
            self.answers = True
            return self._note_miss("missing", f"{error.message}: is it of the configured make?", at_once=True)
        except WrongSensorError as error:
            self.answers = True
            return self._note_miss("missing", str(error), at_once=True)

    def lost(self, text: str) -> FaceSample:
        """Return the sample of a face whose line is gone."""
        self._proven = False
        self.answers = False
        self.note = self._sentence(text)
        return self._sample_without_value("missing")

    async def _ask(self, *, check: bool) -> FaceSample:
        if not self._proven:
            await self._prove()
        elif check and self._pinned is not None and self._make.proof is not None:
            self._require(self._make.serial(await self._read(self._make.proof)))
        told = self._make.decode(await self._read(self._make.data))
        self.answers = True
        if self._doubtful:
            # A late reply to an earlier question would look like this one: only the next reply is believed.
            self._doubtful = False
            return self._sample_without_value("late")
        self._misses = 0
        self.note = self._sentence(told.note) if told.note else ""
        return FaceSample(told.w_m2, self._utc_s(), self._now(), told.flaw, note=self.note)

    async def _prove(self) -> None:
        """Ask who it is. The reply has another length than one to `data`, so neither passes for the other if late."""
        proof = self._make.proof
        if proof is not None:
            try:
                words = await self._read(proof)
            except RefusedError:
                # A refusal is an answer too, and proves as much, except for the serial number.
                if self._pinned is not None:
                    raise
            else:
                more = [await self._read(block) for block in self._make.more]
                who = self._make.identify(words, *more)
                self._require(who.serial)
                self.identity = who.text
        self._proven = True

    def _require(self, serial: int | None) -> None:
        if self._pinned is not None and serial != self._pinned:
            self._proven = False
            raise WrongSensorError(
                f"has the serial number {serial}, but {self._pinned} is configured: sensors or addresses are"
                f" interchanged; set instruments.cube.{self._face}.serial only after looking at the type plate"
            )

    async def _read(self, block: Block) -> Words:
        return await self._bus.read(self.unit, *block, self._within_s)

    def _note_miss(self, flaw: FaceFlaw, why: str, *, at_once: bool = False) -> FaceSample:
        if not at_once:
            self.answers = False
            for each in (self, *self.same_address_sensors):
                each.doubt()
        self._proven = False
        self._misses += 1
        self._flaw = flaw
        if self._misses >= _MISSES_BEFORE_PAUSE:
            # Bounded before the power: a sensor may be dead for years.
            pause_s = _FIRST_PAUSE_S * 2.0 ** min(self._misses - _MISSES_BEFORE_PAUSE, 8)
            self._ask_again_s = self._now() + min(pause_s, _LONGEST_PAUSE_S)
        if at_once or self._misses >= _MISSES_BEFORE_NOTE:
            self.note = self._sentence(why)
        return self._sample_without_value(flaw)

    def _sample_without_value(self, flaw: FaceFlaw) -> FaceSample:
        return FaceSample(math.nan, self._utc_s(), self._now(), flaw, note=self.note)

    def _sentence(self, text: str) -> str:
        return f"the {self._face} sensor (address {self.unit}) {text}"
