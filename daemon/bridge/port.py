"""The bridge's UDP port. It waits for its network if that is not there yet, and is read in batches.

On Linux a sender of authentic scans gets a receive buffer of its own.
"""

import asyncio
import contextlib
import errno
import hashlib
import logging
import math
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daemon.base.addresses import ANY_INTERFACE, Address, BridgeError, is_local_address
from daemon.base.clock import Clock
from daemon.base.process import SystemdNotifier
from daemon.base.reconnect import Outage

_log = logging.getLogger("heliocube.bridge")

Peer = tuple[Any, ...]
"""A socket's address: host and port, and for IPv6 two more numbers."""

# At most this many datagrams, about a millisecond, are read before the event loop's other tasks have their turn.
_BATCH = 64
_LARGEST_READ = 65536
# The kernel grants no more than net.core.rmem_max, on many machines 208 KiB.
_BUFFER_BYTES = 4 << 20
_MOST_LINES = 4
_LOOK_AGAIN_S = 5.0
# A network that comes up with the machine, or a cable that is put back, is there sooner. A network that comes and goes
# raises one alarm.
_ALARM_AFTER_S = _OVER_AFTER_S = 60.0
# These errors say that an address, or the network of a group, is not there now; it may come.
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.ENODEV)
# No peer loses its line to another peer within this time after the last scan that came over it.
_HELD_S = 60.0
_NOT_ON_THIS_MACHINE = (
    "is not an address of this machine now, and the bridge waits for it; if the address is wrong, set one of this"
    " machine's, or 0.0.0.0"
)
# socket(7), <asm-generic/socket.h>: the kernel stamps each datagram with the system's time when it comes.
_SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@ll")
# ip(7), <linux/in.h>: unless it is 0, a socket also hears the groups that other programs of the machine have joined.
_IP_MULTICAST_ALL = 49
# ip(7), the end of struct ip_mreqn: no address, and the index of the network's interface.
_MREQN_BY_INDEX = struct.Struct("@4xi")
# How many datagrams that waited are read at the start: more than a buffer holds, and a flood cannot prolong it.
_MOST_WAITING = 8192
# A longer wait means that the clock was set meanwhile.
_LONGEST_WAIT_S = 300.0


class _NotHereError(BridgeError):
    """An address or a network that the settings name is not on this machine now, and may come."""


class UdpPort:
    """One bound port, and on Linux a line for each of a few peers: a second socket on the port, connected to the peer.

    The kernel hands a peer's datagrams to the socket that is connected to it. So a flood from anybody else fills
    another buffer, and none of the peer's datagrams is dropped because of it.

    An address that is not on this machine, or a group whose network is not, may come: the port looks for it every few
    seconds, and reports its absence as an outage and as an alarm.

    Parameters
    ----------
    listen
        Address and port; port 0 is any that is free.
    group, interface
        The multicast group to join, or None, and the address of the network to join it in.
    receive
        Called with each datagram, its peer, and how long it has waited for a process to read it [s]; must not raise.
    keeper
        The service manager, which holds the port while the process is restarted: nothing that comes meanwhile is lost.
    clock
        Times outages.
    alarm
        Raises an alarm, or ends it with None.
    """

    def __init__(
        self,
        listen: Address,
        group: Address | None,
        interface: str,
        receive: Callable[[bytes, Peer, float], None],
        keeper: SystemdNotifier,
        clock: Clock,
        alarm: Callable[[str, str | None], None],
    ) -> None:
        self._listen = listen
        self._group = group
        self._interface = interface
        self._receive = receive
        self._keeper = keeper
        self._clock = clock
        self._alarm = alarm
        self._bound: socket.socket | None = None
        self._was_kept = self._is_reading = False
        self._look_timer: asyncio.TimerHandle | None = None
        self._outage = Outage(_log, "the bridge")
        self._last_well_s = self._last_deaf_s = -math.inf
        self._networks: set[int] = set()
        self._has_joined = False
        self._lines: dict[Peer, socket.socket] = {}
        self._last_scan_s: dict[Peer, float] = {}

    @property
    def address(self) -> Address:
        """Where it listens; the true port once it is open."""
        return self._listen if self._bound is None else Address(*self._bound.getsockname()[:2])

    @property
    def down_why(self) -> str | None:
        """Why nothing can be heard now, in a sentence, or None."""
        return self._outage.reason if self._outage.is_down else None

    def bind(self) -> None:
        """Take the port, kept or new, and join the group; reads nothing yet.

        An address or a network that is not there now is left to `open`. Raises `BridgeError` if waiting cannot help.
        """
        kept = self._keeper.take_stored_socket(self._name_kept)
        if kept is not None:
            kept.setblocking(False)
            self._bound, self._was_kept = kept, True
            self._networks = _networks()
            return
        try:
            self._bind_and_join()
        except _NotHereError:
            # `open` tries again and reports it, once the service keeps records.
            return
        except BridgeError:
            if self._bound is not None:
                self._bound.close()
                self._bound = None
            raise

    def open(self) -> bool:
        """Read from now on in the running loop, first the datagrams that waited; binds if `bind` has not.

        Returns whether datagrams may have waited. Raises `BridgeError`.
        """
        if self._bound is None:
            self.bind()
        waited, self._was_kept = self._was_kept, False
        self._is_reading, self._last_well_s = True, self._clock.monotonic()
        bound = self._bound
        if bound is None or self._may_lose_network:
            self._try_to_listen()
        if bound is not None:
            if waited:
                self._read_what_waited(bound)
            self._read_from(bound)
        return waited

    def close(self) -> None:
        """Release the port."""
        self._is_reading = self._has_joined = False
        for peer in tuple(self._lines):
            self._drop(peer)
        if self._look_timer is not None:
            self._look_timer.cancel()
        if self._bound is not None:
            asyncio.get_running_loop().remove_reader(self._bound)
            self._bound.close()
            self._bound = None

    def dedicate_socket(self, peer: Peer, now_s: float) -> None:
        """Give a peer that has sent an authentic scan, at a monotonic time [s], a line if one is free."""
        if peer in self._lines:
            self._last_scan_s[peer] = now_s
            return
        # Each socket would get a copy of every datagram that is sent to the group.
        if self._bound is None or self._group is not None or sys.platform != "linux":
            return
        if len(self._lines) >= _MOST_LINES:
            idle = min(self._lines, key=self._last_scan_s.__getitem__)
            if now_s - self._last_scan_s[idle] < _HELD_S:
                return
            self._drop(idle)
        line = self._connect_line(self._bound, peer)
        if line is not None:
            self._lines[peer], self._last_scan_s[peer] = line, now_s
            self._read_from(line)

    @property
    def _name_kept(self) -> str:
        """A name made of the settings, so that a port that was kept under other settings is never taken."""
        settings = f"{self._listen} {self._group} {self._interface}"
        return "bridge-" + hashlib.sha256(settings.encode()).hexdigest()[:16]

    def _read_what_waited(self, kept: socket.socket) -> None:
        if sys.platform == "win32":
            return
        with contextlib.suppress(OSError):
            for _ in range(_MOST_WAITING):
                data, ancillary, _, peer = kept.recvmsg(_LARGEST_READ, socket.CMSG_SPACE(_STAMP.size))
                self._receive(data, peer, _waited_s(ancillary))

    @property
    def _may_lose_network(self) -> bool:
        """Whether it listens on a network that can vanish."""
        return self._group is not None or not (self._listen.ip.is_loopback or self._listen.ip.is_unspecified)

    def _try_to_listen(self) -> None:
        """Take the port and the group if their network is there, else report why not; look again in a few seconds."""
        now_s = self._clock.monotonic()
        try:
            self._bind_and_join()
        except BridgeError as error:
            self._last_deaf_s = now_s
            self._outage.down(now_s, str(error))
            if now_s - self._last_well_s >= _ALARM_AFTER_S:
                self._alarm("bridge-down", f"the bridge hears nothing: {error}")
        else:
            self._last_well_s = now_s
            self._outage.up(now_s)
            if now_s - self._last_deaf_s >= _OVER_AFTER_S:
                self._alarm("bridge-down", None)
        self._look_timer = asyncio.get_running_loop().call_later(_LOOK_AGAIN_S, self._try_to_listen)

    def _bind_and_join(self) -> None:
        """Bind and join as far as that is not done; raises `BridgeError` where nothing can be heard."""
        if self._bound is None:
            self._bound = self._bind()
            self._keeper.store_socket(self._name_kept, self._bound)
            if self._is_reading:
                self._read_from(self._bound)
        if self._group is not None:
            self._keep_joined(self._group, self._bound)
        elif not is_local_address(self._listen):
            raise _NotHereError(f"bridge.listen: {self._listen} {_NOT_ON_THIS_MACHINE}")

    def _keep_joined(self, group: Address, bound: socket.socket) -> None:
        """Join a group; join it again after its network was gone, because the kernel then forgets the membership."""
        try:
            self._join(group, bound)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                self._has_joined = True
                return
            remedy = "set bridge.multicast_interface to this machine's address in the network of the cube"
            if error.errno not in _NOT_HERE:
                raise BridgeError(
                    f"bridge.multicast_group: {group} cannot be joined ({error.strerror}): {remedy}"
                ) from None
            if self._interface == ANY_INTERFACE and self._has_joined:
                # Only joining needs a route to the group; a member may hear it without one.
                return
            known = f"{self._interface} is not an address of this machine"
            why = "no network of this machine leads to it" if self._interface == ANY_INTERFACE else known
            raise _NotHereError(
                f"bridge.multicast_group: {group} cannot be joined now, and the bridge tries again: {why}; if that"
                f" is wrong, {remedy}"
            ) from None
        if self._has_joined:
            _log.info("joined the multicast group %s again: its network was down, or another one is used now", group)
        self._has_joined = True

    def _join(self, group: Address, bound: socket.socket) -> None:
        address = socket.inet_aton(group.host)
        bound.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address + socket.inet_aton(self._interface))
        there = _networks()
        # A membership in a network that has gone still counts among the few of a socket (igmp_max_memberships).
        for index in self._networks - there:
            with contextlib.suppress(OSError):
                bound.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, address + _MREQN_BY_INDEX.pack(index))
        self._networks = there

    def _drop(self, peer: Peer) -> None:
        # Datagrams that the line still holds would be lost with it. While it is listed, its peer gets no second one.
        self._read(self._lines[peer])
        line = self._lines.pop(peer)
        del self._last_scan_s[peer]
        asyncio.get_running_loop().remove_reader(line)
        line.close()

    def _read_from(self, opened: socket.socket) -> None:
        asyncio.get_running_loop().add_reader(opened, self._read, opened)

    def _read(self, opened: socket.socket) -> None:
        for _ in range(_BATCH):
            try:
                data, peer = opened.recvfrom(_LARGEST_READ)
            except BlockingIOError:
                return
            except OSError as error:
                # If the error matters, scans will be missing, and that is reported.
                _log.debug("the bridge's port reports: %s", error)
                return
            self._receive(data, peer, 0.0)

    def _connect_line(self, bound: socket.socket, peer: Peer) -> socket.socket | None:
        """Return a second socket on the port that hears one peer; None where the system does not let it."""
        line = socket.socket(bound.family, socket.SOCK_DGRAM)
        # Every socket of the port must allow sharing, and for this instant only: no other program may share the port.
        others = (bound, *self._lines.values())
        try:
            _prepare(line)
            for one in (*others, line):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            line.bind(bound.getsockname())
            line.connect(peer)
        except OSError as error:
            _log.debug("no socket of its own for %s: %s", peer[0], error)
            line.close()
            return None
        finally:
            for one in others:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        return line

    def _bind(self) -> socket.socket:
        bound: socket.socket | None = None
        try:
            bound = socket.socket(self._listen.family, socket.SOCK_DGRAM)
            _prepare(bound)
            if self._group is not None and sys.platform != "win32":
                # Several processes of a machine may hear one group; each gets a copy of every datagram.
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((self._listen.host, self._listen.port))
        except OSError as error:
            if bound is not None:
                bound.close()
            kind = _NotHereError if error.errno == errno.EADDRNOTAVAIL else BridgeError
            raise kind(f"bridge.listen: {self._listen} {_why_not_bound(error)}") from None
        if self._group is not None and sys.platform == "linux":
            bound.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        return bound


def _prepare(opened: socket.socket) -> None:
    opened.setblocking(False)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    if sys.platform == "linux":
        opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def _networks() -> set[int]:
    """Return the indices of the interfaces that are there; an adapter that comes back has a new index."""
    found = set()
    # `socket.if_nameindex` needs a netlink socket, which the tracker's systemd unit forbids. Only Linux has the files.
    for file in Path("/sys/class/net").glob("*/ifindex"):
        with contextlib.suppress(OSError, ValueError):
            found.add(int(file.read_text(encoding="ascii")))
    return found


def _waited_s(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Return how long ago a datagram came by the kernel's stamp [s]; 0 where that cannot be known."""
    for level, kind, stamp in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(stamp) == _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack(stamp)
            waited_s = time.time() - (seconds + 1e-9 * nanoseconds)
            return waited_s if 0.0 <= waited_s <= _LONGEST_WAIT_S else 0.0
    return 0.0


def _why_not_bound(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "is in use by another program: stop that program or choose another port"
    if error.errno == errno.EADDRNOTAVAIL:
        return _NOT_ON_THIS_MACHINE
    if error.errno == errno.EACCES:
        return "needs an administrator's rights: choose a port above 1023"
    return f"cannot be bound ({error.strerror}): choose another address or port"
