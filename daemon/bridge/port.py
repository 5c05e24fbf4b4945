"""The bridge's UDP port: read in batches, and with a buffer of its own for whoever sends true scans."""

import asyncio
import contextlib
import errno
import hashlib
import logging
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daemon.base.addresses import Address, BridgeError
from daemon.base.process import Notifier

_log = logging.getLogger("heliocube.bridge")

Peer = tuple[Any, ...]
"""Host, port, and for IPv6 two numbers more."""

# Other tasks of the loop wait for this many datagrams at the most, about a millisecond.
_BATCH = 64
_LARGEST_READ = 65536
# The kernel grants what net.core.rmem_max lets it, on many machines 208 KiB.
_BUFFER_BYTES = 4 << 20
_MOST_LINES = 4
_JOIN_AGAIN_S = 5.0
# Nobody loses a line for somebody else's sake within this time after the last scan that came over it.
_HELD_S = 60.0
# socket(7), <asm-generic/socket.h>: the kernel stamps each datagram with the system's time when it comes.
_SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@ll")
# ip(7), <linux/in.h>: else a socket hears the groups that other programs of the machine have joined, too.
_IP_MULTICAST_ALL = 49
# ip(7), the end of struct ip_mreqn: no address, and the index of the network's interface.
_BY_INDEX = struct.Struct("@4xi")
# Whatever waited while no process read: more than a buffer holds, and an end to it where somebody floods the port.
_MOST_WAITING = 8192
# A longer wait is a clock that was set meanwhile.
_LONGEST_WAIT_S = 300.0


class UdpPort:
    """One bound port, and on Linux a line for each of a few peers: a second socket on the port, connected to the peer.

    The kernel hands a peer's datagrams to the socket that is connected to it. So a flood from anybody else fills
    another buffer, and none of the peer's datagrams is dropped for it.

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
    """

    def __init__(
        self,
        listen: Address,
        group: Address | None,
        interface: str,
        receive: Callable[[bytes, Peer, float], None],
        keeper: Notifier,
    ) -> None:
        self._listen = listen
        self._group = group
        self._interface = interface
        self._receive = receive
        self._keeper = keeper
        self._bound: socket.socket | None = None
        self._was_kept = False
        self._joining: asyncio.TimerHandle | None = None
        self._networks: set[int] = set()
        self._lines: dict[Peer, socket.socket] = {}
        self._proven_s: dict[Peer, float] = {}

    @property
    def address(self) -> Address:
        """Where it listens; the true port once it is open."""
        return self._listen if self._bound is None else Address(*self._bound.getsockname()[:2])

    def bind(self) -> socket.socket:
        """Take the port, kept or new, and join the group; reads nothing yet. Raises `BridgeError`."""
        kept = self._keeper.take_kept(self._name_kept)
        self._was_kept = kept is not None
        self._bound = self._bind() if kept is None else kept
        self._bound.setblocking(False)
        if kept is None:
            self._keeper.keep(self._name_kept, self._bound)
        elif self._group is not None:
            self._networks = _networks()
        return self._bound

    def open(self) -> bool:
        """Read from now on in the running loop, first what waited; binds if that is not done. Raises `BridgeError`.

        Returns whether something may have waited.
        """
        bound = self._bound or self.bind()
        waited, self._was_kept = self._was_kept, False
        if self._group is not None:
            self._stay_in(self._group, bound)
        if waited:
            self._read_what_waited(bound)
        self._read_from(bound)
        return waited

    def close(self) -> None:
        """Release the port."""
        for peer in tuple(self._lines):
            self._drop(peer)
        if self._joining is not None:
            self._joining.cancel()
        if self._bound is not None:
            asyncio.get_running_loop().remove_reader(self._bound)
            self._bound.close()
            self._bound = None

    def favour(self, peer: Peer, now_s: float) -> None:
        """Give whoever has sent a true scan, at a monotonic time [s], a line if there is one to give."""
        if peer in self._lines:
            self._proven_s[peer] = now_s
            return
        # Copies of what comes to a group would go to all sockets.
        if self._bound is None or self._group is not None or sys.platform != "linux":
            return
        if len(self._lines) >= _MOST_LINES:
            idle = min(self._lines, key=self._proven_s.__getitem__)
            if now_s - self._proven_s[idle] < _HELD_S:
                return
            self._drop(idle)
        line = self._connected(self._bound, peer)
        if line is not None:
            self._lines[peer], self._proven_s[peer] = line, now_s
            self._read_from(line)

    @property
    def _name_kept(self) -> str:
        """Another name for other settings, so that a port that was kept is never taken for one that it is not."""
        settings = f"{self._listen} {self._group} {self._interface}"
        return "bridge-" + hashlib.sha256(settings.encode()).hexdigest()[:16]

    def _read_what_waited(self, kept: socket.socket) -> None:
        if sys.platform == "win32":
            return
        with contextlib.suppress(OSError):
            for _ in range(_MOST_WAITING):
                data, ancillary, _, peer = kept.recvmsg(_LARGEST_READ, socket.CMSG_SPACE(_STAMP.size))
                self._receive(data, peer, _waited_s(ancillary))

    def _stay_in(self, group: Address, bound: socket.socket) -> None:
        """Join a group anew where its network has gone and come back: with the network, the kernel forgets it."""
        # As long as nothing has gone it is EADDRINUSE, and ENODEV as long as nothing has come back.
        with contextlib.suppress(OSError):
            self._join(group, bound)
            _log.info("joined the multicast group %s again: its network was down, or another one is used now", group)
        self._joining = asyncio.get_running_loop().call_later(_JOIN_AGAIN_S, self._stay_in, group, bound)

    def _join(self, group: Address, bound: socket.socket) -> None:
        address = socket.inet_aton(group.host)
        bound.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address + socket.inet_aton(self._interface))
        there = _networks()
        # A membership in a network that has gone counts among the few that a socket may have (igmp_max_memberships).
        for index in self._networks - there:
            with contextlib.suppress(OSError):
                bound.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, address + _BY_INDEX.pack(index))
        self._networks = there

    def _drop(self, peer: Peer) -> None:
        # What has come over it would be lost with it; read before it goes, it asks for no second line.
        self._read(self._lines[peer])
        line = self._lines.pop(peer)
        del self._proven_s[peer]
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
                # What it means, if anything, the missing scans will show.
                _log.debug("the bridge's port reports: %s", error)
                return
            self._receive(data, peer, 0.0)

    def _connected(self, bound: socket.socket, peer: Peer) -> socket.socket | None:
        """Return a second socket on the port that hears one peer; None where the system does not let it."""
        line = socket.socket(bound.family, socket.SOCK_DGRAM)
        # Each socket of the port has to agree, and for this instant only: nobody else shall share the port.
        others = (bound, *self._lines.values())
        try:
            _prepare(line)
            for one in (*others, line):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            line.bind(bound.getsockname())
            line.connect(peer)
        except OSError as error:
            _log.debug("no line of its own for %s: %s", peer[0], error)
            line.close()
            return None
        finally:
            for one in others:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        return line

    def _bind(self) -> socket.socket:
        bound = socket.socket(self._listen.family, socket.SOCK_DGRAM)
        try:
            _prepare(bound)
            if self._group is not None and sys.platform != "win32":
                # Several processes of a machine hear one group, each with a copy of everything.
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((self._listen.host, self._listen.port))
        except OSError as error:
            bound.close()
            raise BridgeError(f"bridge.listen: {self._listen} {_why_not_bound(error)}") from None
        if self._group is not None:
            if sys.platform == "linux":
                bound.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            try:
                self._join(self._group, bound)
            except OSError as error:
                bound.close()
                raise BridgeError(
                    f"bridge.multicast_group: {self._group} cannot be joined ({error.strerror}): set"
                    " bridge.multicast_interface to this machine's address in the network of the cube"
                ) from None
        return bound


def _prepare(opened: socket.socket) -> None:
    opened.setblocking(False)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    if sys.platform == "linux":
        opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def _networks() -> set[int]:
    """Return the indices of the interfaces that are there; an adapter that comes back has another one than before."""
    found = set()
    # The units let nobody open the netlink socket that the library's way needs. Elsewhere than on Linux there are none.
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
        return "is not an address of this machine: listen on one of its own, or on 0.0.0.0 for all"
    if error.errno == errno.EACCES:
        return "needs an administrator's rights: choose a port above 1023"
    return f"cannot be bound ({error.strerror}): choose another address or port"
