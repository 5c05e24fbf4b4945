"""Receives scans and passes on those that are authentic, well-formed, fresh and in order. The rest is counted."""

import asyncio
import errno
import ipaddress
import logging
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from daemon.base.addresses import ANY_INTERFACE, Address, BridgeError, parse_address, require_key
from daemon.bridge import senml, signing
from daemon.bridge.refusals import Refusal, ScanRefusedError, Statistics, Tally
from daemon.bridge.sequence import SequenceGuard

if TYPE_CHECKING:
    from daemon.base.clock import Clock
    from daemon.base.records import Scan
    from daemon.config.links import BridgeSettings

_log = logging.getLogger("heliocube.bridge")

LARGEST_DATAGRAM = 2048


class BridgeReceiver(asyncio.DatagramProtocol):
    """Listens on one UDP port and follows one cube.

    Parameters
    ----------
    settings
        The table ``bridge`` of the configuration.
    key
        From `daemon.bridge.signing.load_key`; None takes plain scans, and only where the settings say ``insecure``.
    clock
        Its monotonic time is that of the scans that are passed on.
    on_scan
        Called with each accepted scan, in order. Monotonic times are the receiver's and never decrease; UTC and the
        age of each face within the scan are as sent. Must not raise.

    Raises
    ------
    BridgeError
        When the multicast group cannot be heard where the settings listen, or there is neither a key nor
        ``insecure``.
    """

    def __init__(
        self, settings: "BridgeSettings", key: bytes | None, clock: "Clock", on_scan: Callable[["Scan"], None]
    ) -> None:
        require_key(key, insecure=settings.insecure)
        self._key = key
        self._clock = clock
        self._on_scan = on_scan
        self._listen = parse_address(settings.listen)
        self._group: Address | None = None
        self._interface = settings.multicast_interface or ANY_INTERFACE
        if settings.multicast_group is not None:
            self._group = parse_address(settings.multicast_group)
            self._check_group(self._group)
        self._accept_from = frozenset(_ip_of(text) for text in settings.accept_from)
        self._guard = SequenceGuard(settings.clock_skew_s, settings.late_after_s)
        self._tally = Tally()
        self._transport: asyncio.DatagramTransport | None = None
        self._gone = asyncio.Event()

    @property
    def address(self) -> str:
        """Where a sender on this machine reaches the receiver; the true port once it is open."""
        bound = self._listen
        if self._transport is not None:
            bound = Address(*self._transport.get_extra_info("sockname")[:2])
        return str(bound.reachable)

    @property
    def statistics(self) -> Statistics:
        """A snapshot of all counts."""
        return self._tally.statistics(self._guard.lost)

    @property
    def refused_since_accepted(self) -> str:
        """What was refused since the last scan that was passed on, in words; empty for nothing."""
        return self._tally.since_accepted

    async def open(self) -> None:
        """Bind the port and join the group; `BridgeError` says in one sentence why that is not possible."""
        bound = self._bind()
        self._gone.clear()
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=bound)
        except BaseException:
            bound.close()
            raise

    async def close(self) -> None:
        """Release the port. The memory of sessions stays, so that nothing can be replayed after a reopening."""
        if self._transport is not None:
            self._transport.close()
            await self._gone.wait()
            self._transport = None

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Examine one datagram from `addr`, (host, port, ...), and pass its scan on or count the refusal."""
        self.take(data, str(Address(addr[0], addr[1])), addr[0])

    def take(self, data: bytes, sender: str, host: str | None = None) -> None:
        """Examine one datagram like one from the port; `host` None for a transport that knows no IP addresses."""
        now_s = self._clock.monotonic()
        utc_s = self._clock.utc()
        try:
            scan = self._examine(data, host, utc_s, now_s)
        except ScanRefusedError as refused:
            self._tally.refuse(refused, sender, utc_s, now_s)
            return
        self._tally.accept(now_s)
        self._on_scan(scan)

    def error_received(self, exc: Exception) -> None:
        """Note an error of the socket; what it means, if anything, the missing scans will show."""
        _log.debug("the bridge's port reports: %s", exc)

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the port is closed."""
        if exc is not None:
            _log.error("the bridge's port %s has failed: %s", self._listen, exc)
        self._gone.set()

    def _examine(self, data: bytes, host: str | None, utc_s: float, now_s: float) -> "Scan":
        if len(data) > LARGEST_DATAGRAM:
            raise ScanRefusedError(
                Refusal.OVERSIZED, f"has {len(data)} bytes; a scan has {LARGEST_DATAGRAM} at the most"
            )
        if host is not None and self._accept_from and _ip_of(host) not in self._accept_from:
            raise ScanRefusedError(Refusal.REFUSED_SENDER, "is not from an address in bridge.accept_from")
        if self._key is not None:
            data = signing.verify(data, self._key)
        elif data[:3] == b"eyJ":
            raise ScanRefusedError(
                Refusal.FORGED, "is signed, and this receiver has no key to check it: set bridge.key_file"
            )
        return self._guard.admit(senml.decode(data), utc_s, now_s)

    def _check_group(self, group: Address) -> None:
        if self._listen.port != group.port:
            raise BridgeError(
                f"bridge.listen: port {self._listen.port} and that of bridge.multicast_group {group} must be the same"
            )
        if self._listen.host not in {ANY_INTERFACE, group.host}:
            raise BridgeError(
                f"bridge.listen: {self._listen} cannot hear the multicast group {group}: listen on 0.0.0.0:{group.port}"
            )

    def _bind(self) -> socket.socket:
        bound = socket.socket(self._listen.family, socket.SOCK_DGRAM)
        try:
            bound.setblocking(False)
            bound.bind((self._listen.host, self._listen.port))
        except OSError as error:
            bound.close()
            raise BridgeError(f"bridge.listen: {self._listen} {_why_not_bound(error)}") from None
        if self._group is not None:
            try:
                membership = socket.inet_aton(self._group.host) + socket.inet_aton(self._interface)
                bound.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            except OSError as error:
                bound.close()
                raise BridgeError(
                    f"bridge.multicast_group: {self._group} cannot be joined ({error.strerror}): set"
                    " bridge.multicast_interface to this machine's address in the network of the cube"
                ) from None
        return bound


def _why_not_bound(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "is in use by another program: stop that program or choose another port"
    if error.errno == errno.EADDRNOTAVAIL:
        return "is not an address of this machine: listen on one of its own, or on 0.0.0.0 for all"
    if error.errno == errno.EACCES:
        return "needs an administrator's rights: choose a port above 1023"
    return f"cannot be bound ({error.strerror}): choose another address or port"


def _ip_of(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return an address of the allow-list or of a sender; IPv4 within IPv6 is IPv4."""
    ip = ipaddress.ip_address(text.partition("%")[0])
    return (ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None) or ip
