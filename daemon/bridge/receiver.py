"""Receives scans and passes on those that are authentic, well-formed, fresh and in order. The rest is counted."""

import ipaddress
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

from daemon.base.addresses import ANY_INTERFACE, Address, BridgeError, parse_address, require_key, unmap_ipv4
from daemon.base.process import SystemdNotifier
from daemon.bridge import senml, signing
from daemon.bridge.port import Peer, UdpPort
from daemon.bridge.refusals import Refusal, ScanRefusedError, Statistics, Tally
from daemon.bridge.sequence import SequenceGuard

if TYPE_CHECKING:
    from daemon.base.clock import Clock
    from daemon.base.records import Scan
    from daemon.config.links import BridgeSettings

LARGEST_DATAGRAM = 2048


class BridgeReceiver:
    """Listens on one UDP port and follows one cube.

    Parameters
    ----------
    settings
        The table ``bridge`` of the configuration.
    key
        From `daemon.bridge.signing.load_key`; None takes plain scans, and only where the settings say ``insecure``.
        `take_keys` gives it more than one.
    clock
        Its monotonic time is that of the scans that are passed on.
    on_scan
        Called with each accepted scan, in order. Monotonic times are the receiver's and never decrease; UTC and the
        age of each face within the scan are as sent. Must not raise.
    keeper
        The service manager, which holds the port while the process is restarted; None where there is none.
    alarm
        Raises the alarm that an address or a network of the settings is not on this machine now, or ends it with None.

    Raises
    ------
    BridgeError
        When the multicast group cannot be heard where the settings listen, or there is neither a key nor
        ``insecure``.
    """

    def __init__(
        self,
        settings: "BridgeSettings",
        key: bytes | None,
        clock: "Clock",
        on_scan: Callable[["Scan"], None],
        keeper: SystemdNotifier | None = None,
        alarm: Callable[[str, str | None], None] = lambda _name, _text: None,
    ) -> None:
        require_key(key, insecure=settings.insecure)
        self._keys: tuple[bytes, ...] = () if key is None else (key,)
        self._clock = clock
        self._on_scan = on_scan
        self._listen = parse_address(settings.listen)
        self._group: Address | None = None
        if settings.multicast_group is not None:
            self._group = parse_address(settings.multicast_group)
            self._check_group(self._group)
        self._accept_from = frozenset(_ip_of(text) for text in settings.accept_from)
        self._guard = SequenceGuard(settings.clock_skew_s, settings.late_after_s)
        self._tally = Tally()
        interface = settings.multicast_interface or ANY_INTERFACE
        self._port = UdpPort(
            self._listen, self._group, interface, self.datagram_received, keeper or SystemdNotifier({}, 0), clock, alarm
        )

    @property
    def address(self) -> str:
        """Where a sender on this machine reaches the receiver; the true port once it is open."""
        return str(self._port.address.reachable_address)

    @property
    def statistics(self) -> Statistics:
        """A snapshot of all counts."""
        return self._tally.statistics(self._guard.lost)

    @property
    def down_why(self) -> str | None:
        """Why nothing can be heard now: an address or a network of the settings is not there. None if it is."""
        return self._port.down_why

    @property
    def refused_since_accepted(self) -> str:
        """What was refused since the last scan that was passed on, in words; empty for nothing."""
        return self._tally.since_accepted

    def bind(self) -> None:
        """Take the port and join the group as far as they are on this machine now, and read nothing yet.

        Raises `BridgeError`, one sentence, if waiting cannot help.
        """
        self._port.bind()

    async def open(self) -> None:
        """Bind the port if that is not done, and read from now on, first the datagrams that came while no process read.

        An address or a network that is not on this machine now is looked for until it is there. Raises `BridgeError`,
        one sentence, if waiting cannot help.
        """
        if self._port.open():
            # The wait for this process is no delay of the network, and a clock may have been set meanwhile.
            self._guard.forget_delays()

    async def close(self) -> None:
        """Release the port. The memory of sessions stays, so that nothing can be replayed after a reopening."""
        self._port.close()

    def take_keys(self, keys: tuple[bytes, ...]) -> None:
        """Accept scans signed with any of these keys from now on; not for a receiver that was made without a key."""
        self._keys = keys

    def datagram_received(self, data: bytes, addr: Peer, waited_s: float = 0.0) -> None:
        """Examine one datagram from `addr`, (host, port, ...), and pass its scan on or count the refusal.

        It came `waited_s` ago [s], and is judged and dated by the time when it came.
        """
        if self._examine_and_pass_on(data, addr, addr[0], waited_s):
            self._port.dedicate_socket(addr, self._clock.monotonic())

    def take(self, data: bytes, sender: str) -> None:
        """Examine a scan that came over a transport without IP addresses, as a datagram is examined."""
        self._examine_and_pass_on(data, sender, None)

    def take_own(self, data: bytes) -> None:
        """Examine a scan that this process sends itself while its address is not there, as if it came from there."""
        self._examine_and_pass_on(data, str(self._listen), self._listen.host)

    def _examine_and_pass_on(self, data: bytes, sender: str | Peer, host: str | None, waited_s: float = 0.0) -> bool:
        now_s = self._clock.monotonic() - waited_s
        utc_s = self._clock.utc() - waited_s
        try:
            scan = self._examine(data, host, utc_s, now_s)
        except ScanRefusedError as refused:
            self._tally.refuse(refused, sender, utc_s, now_s)
            return False
        self._tally.accept(now_s)
        self._on_scan(scan)
        return True

    def _examine(self, data: bytes, host: str | None, utc_s: float, now_s: float) -> "Scan":
        if len(data) > LARGEST_DATAGRAM:
            raise ScanRefusedError(
                Refusal.OVERSIZED, f"has {len(data)} bytes; a scan has {LARGEST_DATAGRAM} at the most"
            )
        if host is not None and self._accept_from and _ip_of(host) not in self._accept_from:
            raise ScanRefusedError(Refusal.REFUSED_SENDER, "is not from an address in bridge.accept_from")
        if self._keys:
            data = signing.verify(data, *self._keys)
        elif data[:3] == b"eyJ":
            raise ScanRefusedError(
                Refusal.FORGED, "is signed, and this receiver has no key to check it: set bridge.key_file"
            )
        head = senml.peek(data)
        if head is not None:
            # To refuse a replay by its head costs a tenth of decoding all of it.
            self._guard.screen(head, utc_s, now_s)
        return self._guard.admit(senml.decode(data), utc_s, now_s)

    def _check_group(self, group: Address) -> None:
        if self._listen.port != group.port:
            raise BridgeError(
                f"bridge.listen: port {self._listen.port} must be the same as that of bridge.multicast_group {group}"
            )
        if self._listen.host not in {ANY_INTERFACE, group.host}:
            raise BridgeError(
                f"bridge.listen: {self._listen} cannot hear the multicast group {group}: listen on 0.0.0.0:{group.port}"
            )


@lru_cache(maxsize=1024)
def _ip_of(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return an address of the allow-list or of a sender; IPv4 within IPv6 is IPv4."""
    return ipaddress.ip_address(unmap_ipv4(text.partition("%")[0]))
