"""Sends every scan at once to every tracker. A target that cannot be reached never holds up the others."""

import logging
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daemon.bridge import senml, signing
from daemon.bridge.addresses import Address, BridgeError, address_of, group_of, require_key

if TYPE_CHECKING:
    from daemon.clock import Clock
    from daemon.config import Bridge
    from daemon.records import Scan

_log = logging.getLogger("heliocube.bridge")

FIRST_HOLD_S = 60.0
LONGEST_HOLD_S = 3600.0
FORGIVEN_AFTER_S = 6 * 3600.0


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
        When the settings name no target, a wrong address, or neither a key nor ``insecure``.
    """

    def __init__(self, settings: "Bridge", key: bytes | None, clock: "Clock") -> None:
        require_key(key, insecure=settings.insecure)
        self._key = key
        self._clock = clock
        self._open = False
        self._targets = [_Target(address_of("bridge.send_to", text)) for text in settings.send_to]
        if settings.multicast_group is not None:
            group, local = group_of(settings.multicast_group, settings.multicast_interface)
            self._targets.append(_Target(group, local, settings.multicast_ttl))
        if not self._targets:
            raise BridgeError(
                "bridge.send_to is empty and bridge.multicast_group is not set: name at least one tracker"
            )
        for target in self._targets:
            if not target.address.port:
                raise BridgeError(f"bridge.send_to: {str(target.address)!r} has port 0, which nothing can listen on")

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
        datagram = senml.encode(scan)
        if self._key is not None:
            datagram = signing.sign(datagram, self._key)
        now_s = self._clock.monotonic()
        for target in self._targets:
            target.send(datagram, now_s)


class _Target:
    """One destination: a connected socket, opened when needed, and the story of its outages."""

    def __init__(self, address: Address, multicast_from: str | None = None, multicast_ttl: int = 1) -> None:
        self.address = address
        self._multicast_from = multicast_from
        self._multicast_ttl = multicast_ttl
        self._socket: socket.socket | None = None
        self._sent = 0
        self._failed = 0
        self._last_error = ""
        self._failing = False
        self._outage = _OutageLog(str(address))

    @property
    def statistics(self) -> TargetStatistics:
        return TargetStatistics(str(self.address), self._sent, self._failed, self._last_error, self._failing)

    def send(self, datagram: bytes, now_s: float) -> None:
        error: OSError | None = None
        try:
            try:
                self._connected().send(datagram)
            except ConnectionRefusedError as refused:
                # The kernel reports the datagram before by failing this one, so this one goes again.
                error = refused
                self._connected().send(datagram)
            self._sent += 1
        except OSError as failure:
            error = failure
            self._failed += 1
            if not isinstance(failure, ConnectionRefusedError | BlockingIOError):
                # A socket stays bound to the address that this machine had; a new one learns the new address.
                self.close()
        self._failing = error is not None
        if error is None:
            self._outage.good(now_s)
        else:
            self._last_error = error.strerror or str(error)
            self._outage.bad(now_s, self._last_error)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> socket.socket:
        if self._socket is None:
            opened = socket.socket(self.address.family, socket.SOCK_DGRAM)
            try:
                opened.setblocking(False)
                if self._multicast_from is not None:
                    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._multicast_ttl)
                    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(self._multicast_from))
                opened.connect((self.address.host, self.address.port))
            except OSError:
                opened.close()
                raise
            self._socket = opened
        return self._socket


class _OutageLog:
    """Says once that a target is down and once that it is up again, also for one that comes and goes.

    Up is said after a stretch without errors; the stretch doubles from outage to outage, to an hour at most, and
    begins anew after six good hours.
    """

    def __init__(self, target: str) -> None:
        self._target = target
        self._hold_s = FIRST_HOLD_S / 2
        self._began_s: float | None = None
        self._last_bad_s: float | None = None
        self._errors = 0

    def bad(self, now_s: float, reason: str) -> None:
        if self._began_s is None:
            if self._last_bad_s is not None and now_s - self._last_bad_s >= FORGIVEN_AFTER_S:
                self._hold_s = FIRST_HOLD_S / 2
            self._hold_s = min(2 * self._hold_s, LONGEST_HOLD_S)
            self._began_s, self._errors = now_s, 0
            _log.warning("scans do not reach %s: %s", self._target, reason)
        self._errors += 1
        self._last_bad_s = now_s

    def good(self, now_s: float) -> None:
        if self._began_s is None or self._last_bad_s is None or now_s - self._last_bad_s < self._hold_s:
            return
        _log.info(
            "scans go out to %s again: %d errors within %.0f s, none for the last %.0f s",
            self._target,
            self._errors,
            self._last_bad_s - self._began_s,
            now_s - self._last_bad_s,
        )
        self._began_s = None
