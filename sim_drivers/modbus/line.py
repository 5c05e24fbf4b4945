"""Several simulated devices on one line: the one addressed answers; two of one address garble each other's replies."""

from collections.abc import Sequence
from typing import Any, Protocol

from drivers.modbus.framing import ReceivedRequest, RtuServer, ServerFraming
from drivers.modbus.server import RegisterTable, answer

# From the end of a question to the beginning of its answer.
_TURNAROUND_S = 0.005


class SimulatedDevice(RegisterTable, Protocol):
    """A device with its address and its faults, as `sim_drivers.modbus.pyranometers.SimulatedPyranometer` has them."""

    address: int
    silent: bool
    delay_s: float
    corrupt: int
    deaf_s: float
    now_s: float

    def power_cycle(self, now_s: float) -> None:
        """Switch it off and on."""

    def state(self) -> dict[str, Any]:
        """Return who it is and how it is, as plain data."""


class DeviceLineCore:
    """The line.

    Parameters
    ----------
    sensors
        The devices on it; one may be named several times. The list may be changed at any time.
    framing
        RTU unless given.
    """

    aborts = 0
    """Always 0: no device here drops a reply."""

    def __init__(self, sensors: Sequence[SimulatedDevice], framing: ServerFraming | None = None) -> None:
        self.sensors = list(dict.fromkeys(sensors))
        self.questions = 0
        self._framing: ServerFraming = framing or RtuServer()
        self._is_one_pair = framing is None
        self._replied_s: list[float] = []

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it begins."""
        found = []
        for asked in self._framing.feed(data, now):
            self.questions += 1
            found += self._answers(asked, now)
        return found

    def power_cycle(self, now: float) -> None:
        """Switch all of them off and on."""
        for sensor in self.sensors:
            sensor.power_cycle(now)

    def swap(self, one: int, other: int) -> None:
        """Let two sensors, by their place, answer to each other's address."""
        first, second = self.sensors[one], self.sensors[other]
        first.address, second.address = second.address, first.address

    def _is_heard_by(self, sensor: SimulatedDevice, now: float) -> bool:
        """Tell whether a question reaches a sensor: on one pair, one that comes soon after a reply does not."""
        if not (self._is_one_pair and sensor.deaf_s):
            return True
        self._replied_s = [at_s for at_s in self._replied_s if now < at_s + sensor.deaf_s]
        return not any(at_s <= now for at_s in self._replied_s)

    def _answers(self, asked: ReceivedRequest, now: float) -> list[tuple[float, bytes]]:
        replies = []
        for sensor in self.sensors:
            if sensor.address != asked.request.unit or sensor.silent or not self._is_heard_by(sensor, now):
                continue
            sensor.now_s = now
            pdu = answer(sensor, asked.request.pdu)
            if pdu is None:
                continue
            frame = self._framing.reply(asked, pdu)
            if sensor.corrupt > 0:
                sensor.corrupt -= 1
                frame = frame[:-1] + bytes((frame[-1] ^ 0x55,))
            replies.append((now + _TURNAROUND_S + sensor.delay_s, frame))
        if len(replies) > 1:
            # Both drive the wires at once.
            replies = [(replies[0][0], bytes(x & y for x, y in zip(replies[0][1], replies[1][1], strict=False)))]
        # A reply is handed over whole, and so has ended when it is due.
        self._replied_s += [due_s for due_s, _ in replies]
        return replies
