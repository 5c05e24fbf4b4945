"""Frames around Modbus: RTU with its checksum on serial lines, TCP with its transaction numbers; for both ends.

Nothing here reads or writes: bytes are handed in and out. A client's framing has one question open at a time and
takes only the reply that belongs to it: all else that comes, above all late replies, is thrown away.
"""

import struct
from typing import NamedTuple, Protocol

from drivers.modbus.pdu import (
    EXCEPTION_FLAG,
    READ_COILS,
    WRITE_COILS,
    WRITE_REGISTER,
    WRITE_REGISTERS,
    ModbusRequest,
    reply_length,
    reply_matches,
)

_TCP_HEAD = struct.Struct(">HHHB")
# Longest frame of each kind, by the standards.
_LONGEST_PDU = 253
_LONGEST_RTU = 256
# Address, function and checksum.
_SHORTEST_RTU = 4
# A pause within a frame that ends it, for a server; the standard has 3.5 characters, which USB adapters do not keep.
_BROKEN_AFTER_S = 0.1


def crc16(data: bytes) -> bytes:
    """Return the checksum of a frame of RTU, low byte first as it is sent."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


class BrokenStreamError(Exception):
    """What comes over TCP is not Modbus: the connection has to be made anew."""


class ClientFraming(Protocol):
    """One end of a line: puts a question into a frame and finds its reply in what comes."""

    def begin(self, request: ModbusRequest) -> bytes:
        """Forget the question before, and return the frame of this one."""

    def feed(self, data: bytes) -> bytes | None:
        """Take in what has come; return the reply's function and data once it is complete.

        Raises `BrokenStreamError` if the frames can never be found again in what comes.
        """


class RtuClient:
    """RTU: on serial lines, and on TCP behind boxes that pass the bytes on as they are."""

    def __init__(self) -> None:
        self._request: ModbusRequest | None = None
        self._buffer = b""

    def begin(self, request: ModbusRequest) -> bytes:
        """Return the frame; what has come before belongs to no question any more."""
        self._request, self._buffer = request, b""
        frame = bytes((request.unit,)) + request.pdu
        return frame + crc16(frame)

    def feed(self, data: bytes) -> bytes | None:
        """Return the reply: the first frame with this address, this function, this length and a right checksum."""
        request = self._request
        if request is None:
            return None
        self._buffer += data
        function = request.pdu[0]
        for head, length in (
            (bytes((request.unit, function)), reply_length(request.pdu)),
            (bytes((request.unit, function | EXCEPTION_FLAG)), 2),
        ):
            start = self._buffer.find(head)
            while start >= 0:
                frame = self._buffer[start : start + length + 3]
                if crc16(frame[:-2]) == frame[-2:] and reply_matches(request.pdu, frame[1:-2]):
                    self._request, self._buffer = None, b""
                    return frame[1:-2]
                start = self._buffer.find(head, start + 1)
        self._buffer = self._buffer[-2 * _LONGEST_RTU :]
        return None


class TcpClient:
    """Modbus TCP: every question has a number, and its reply bears it."""

    def __init__(self) -> None:
        self._number = 0
        self._request: ModbusRequest | None = None
        self._buffer = b""

    def begin(self, request: ModbusRequest) -> bytes:
        """Return the frame, with the next number."""
        self._number = self._number % 0xFFFF + 1
        self._request = request
        return _tcp_frame(self._number, request)

    def feed(self, data: bytes) -> bytes | None:
        """Return the reply that bears the number of the question."""
        self._buffer += data
        while (taken := _tcp_taken(self._buffer)) is not None:
            transaction, reply, self._buffer = taken
            request = self._request
            if request is None or transaction != self._number or reply.unit != request.unit:
                continue
            if reply_matches(request.pdu, reply.pdu):
                self._request = None
                return reply.pdu
        return None


class ReceivedRequest(NamedTuple):
    """A question as it came to a server; the number is 0 on a serial line."""

    request: ModbusRequest
    transaction: int = 0


class ServerFraming(Protocol):
    """The other end: finds questions, and puts replies into frames."""

    def feed(self, data: bytes, now_s: float) -> list[ReceivedRequest]:
        """Take in what has come at a monotonic time [s] and return the questions that are complete.

        Raises `BrokenStreamError` where the connection has to be closed.
        """

    def reply(self, asked: ReceivedRequest, pdu: bytes) -> bytes:
        """Return the frame of a reply."""


class RtuServer:
    """RTU: a frame with a wrong checksum is no question, and is not answered."""

    def __init__(self) -> None:
        self._buffer = b""
        self._last_s = 0.0

    def feed(self, data: bytes, now_s: float) -> list[ReceivedRequest]:
        """Return the questions."""
        if now_s - self._last_s > _BROKEN_AFTER_S:
            self._buffer = b""
        self._last_s = now_s
        self._buffer += data
        found = []
        while (length := _request_length(self._buffer)) is not None and length <= len(self._buffer):
            frame = self._buffer[:length]
            if crc16(frame[:-2]) == frame[-2:]:
                found.append(ReceivedRequest(ModbusRequest(frame[0], frame[1:-2])))
                self._buffer = self._buffer[length:]
            else:
                self._buffer = self._buffer[1:]
        return found

    def reply(self, asked: ReceivedRequest, pdu: bytes) -> bytes:
        """Return the frame of a reply."""
        frame = bytes((asked.request.unit,)) + pdu
        return frame + crc16(frame)


class TcpServer:
    """Modbus TCP."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes, now_s: float) -> list[ReceivedRequest]:  # noqa: ARG002 - TCP knows where a frame ends
        """Return the questions."""
        self._buffer += data
        found = []
        while (taken := _tcp_taken(self._buffer)) is not None:
            transaction, request, self._buffer = taken
            found.append(ReceivedRequest(request, transaction))
        return found

    def reply(self, asked: ReceivedRequest, pdu: bytes) -> bytes:
        """Return the frame of a reply."""
        return _tcp_frame(asked.transaction, ModbusRequest(asked.request.unit, pdu))


def _tcp_frame(transaction: int, request: ModbusRequest) -> bytes:
    return _TCP_HEAD.pack(transaction, 0, len(request.pdu) + 1, request.unit) + request.pdu


def _tcp_taken(buffer: bytes) -> tuple[int, ModbusRequest, bytes] | None:
    """Return number and contents of the first frame, and what is left; None while it is not complete."""
    if len(buffer) < _TCP_HEAD.size:
        return None
    transaction, protocol, length, unit = _TCP_HEAD.unpack_from(buffer)
    if protocol != 0 or not 2 <= length <= _LONGEST_PDU + 1:
        raise BrokenStreamError
    end = _TCP_HEAD.size + length - 1
    if len(buffer) < end:
        return None
    return transaction, ModbusRequest(unit, buffer[_TCP_HEAD.size : end]), buffer[end:]


def _request_length(buffer: bytes) -> int | None:
    """Return the length of the RTU frame at the beginning, taken as a question; None while that cannot be told."""
    if len(buffer) < _SHORTEST_RTU:
        return None
    if buffer[1] in (WRITE_COILS, WRITE_REGISTERS):
        return 9 + buffer[6] if len(buffer) > 6 else None
    # A function whose length is not known here is taken to have no data, and is refused.
    return 8 if READ_COILS <= buffer[1] <= WRITE_REGISTER else _SHORTEST_RTU
