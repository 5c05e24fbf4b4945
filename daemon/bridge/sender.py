"""Sends every scan at once to every tracker. A target that cannot be reached never holds up the others."""

import errno
import logging
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daemon.base.addresses import ANY_INTERFACE, Address, BridgeError, parse_address, require_key
from daemon.base.reconnect import Outage
from daemon.bridge import senml, signing

if TYPE_CHECKING:
    from daemon.base.clock import Clock
    from daemon.base.records import Scan
    from daemon.config.links import BridgeSettings

_log = logging.getLogger("heliocube.bridge")

# A target counts as back after this long without an error, so that one that comes and goes is one outage.
BACK_AFTER_S = 600.0

_Options = dict[int, int | bytes]


@dataclass(frozen=True, slots=True)
class TargetStatistics:
    """What became of the datagrams to one target.

    Attributes
    ----------
    target
        Address and port.
    sent, failed
        Datagrams handed to the network, and those that it refused. UDP does not tell more.
    last_error
        Why the latest failed; empty when none did.
    down
        Whether the latest send met an error.
    """

    target: str
    sent: int
    failed: int
    last_error: str
    down: bool


class BridgeSender:
    """Sends scans to the unicast targets and the multicast group of the settings.

    Parameters
    ----------
    settings
        The table ``bridge`` of the configuration.
    key
        From `daemon.bridge.signing.load_key`; None sends plain, and only where the settings say ``insecure``.
    clock
        Times outages.

    Raises
    ------
    BridgeError
        When the settings name no target, or neither a key nor ``insecure``.
    """

    def __init__(self, settings: "BridgeSettings", key: bytes | None, clock: "Clock") -> None:
        require_key(key, insecure=settings.insecure)
        self._key = key
        self._clock = clock
        self._open = False
        self._targets = [_Target(parse_address(text)) for text in settings.send_to]
        if settings.multicast_group is not None:
            local = socket.inet_aton(settings.multicast_interface or ANY_INTERFACE)
            options: _Options = {socket.IP_MULTICAST_TTL: settings.multicast_ttl, socket.IP_MULTICAST_IF: local}
            self._targets.append(_Target(parse_address(settings.multicast_group), options))
        if not self._targets:
            raise BridgeError(
                "bridge.send_to is empty and bridge.multicast_group is not set: name at least one tracker"
            )

    def take_key(self, key: bytes) -> None:
        """Sign with another key from now on; not for a sender that was made without one."""
        self._key = key

    @property
    def statistics(self) -> tuple[TargetStatistics, ...]:
        """One snapshot per target, in the order of the settings, the multicast group last."""
        return tuple(target.statistics for target in self._targets)

    async def open(self) -> None:
        """Make ready to send. Raises nothing: a network that is not up yet is an outage like any other."""
        self._open = True

    async def close(self) -> None:
        """Release the sockets. Never raises."""
        self._open = False
        for target in self._targets:
            target.close()

    def send(self, scan: "Scan") -> None:
        """Send `scan` to every target, now and without waiting. Errors of the network are counted and logged."""
        if not self._open:
            raise RuntimeError("the bridge's sender is not open")
        datagram = pack(scan, self._key)
        now_s = self._clock.monotonic()
        for target in self._targets:
            target.send(datagram, now_s)


def pack(scan: "Scan", key: bytes | None) -> bytes:
    """Return the message for `scan`, over UDP or a broker: signed with `key`, or plain if that is None."""
    payload = senml.encode(scan)
    return payload if key is None else signing.sign(payload, key)


def _in_words(error: OSError) -> str:
    text = error.strerror or str(error)
    # The system's error for a network's broadcast address; only the network's mask tells that an address is one.
    hint = "; for the broadcast address of a network: name each tracker, or set bridge.multicast_group"
    return f"{text}{hint}" if error.errno == errno.EACCES else text


class _Target:
    """One destination: a connected socket, opened when needed, and what became of the datagrams."""

    def __init__(self, address: Address, options: _Options | None = None) -> None:
        self.address = address
        self._options = options or {}
        self._socket: socket.socket | None = None
        self._sent = 0
        self._failed = 0
        self._last_error = ""
        self._failing = False
        self._outage = Outage(_log, f"the way of the scans to {address}")
        self._last_error_s = 0.0

    @property
    def statistics(self) -> TargetStatistics:
        return TargetStatistics(
            target=str(self.address),
            sent=self._sent,
            failed=self._failed,
            last_error=self._last_error,
            down=self._failing,
        )

    def send(self, datagram: bytes, now_s: float) -> None:
        error: OSError | None = None
        try:
            try:
                self._connected_socket().send(datagram)
            except ConnectionRefusedError as refused:
                # The kernel reports that the previous datagram failed by failing this one, so this one is sent again.
                error = refused
                self._connected_socket().send(datagram)
            self._sent += 1
        except OSError as failure:
            error = failure
            self._failed += 1
            # A socket stays bound to the address that this machine had; a new socket gets the new address.
            self.close()
        self._failing = error is not None
        if error is not None:
            self._last_error = _in_words(error)
            self._last_error_s = now_s
            self._outage.down(now_s, self._last_error)
        elif now_s - self._last_error_s >= BACK_AFTER_S:
            self._outage.up(self._last_error_s if self._outage.is_down else now_s)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected_socket(self) -> socket.socket:
        if self._socket is None:
            opened = socket.socket(self.address.family, socket.SOCK_DGRAM)
            try:
                opened.setblocking(False)
                for option, value in self._options.items():
                    opened.setsockopt(socket.IPPROTO_IP, option, value)
                opened.connect((self.address.host, self.address.port))
            except OSError:
                opened.close()
                raise
            self._socket = opened
        return self._socket
