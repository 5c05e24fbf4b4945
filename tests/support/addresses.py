"""Numbers of ports for the servers of tests, which nobody else gets meanwhile: no other worker, run or client.

A port that was free a moment ago may be somebody's own end of a connection a moment later, or what another test has
found free too. So each process of tests has a block to itself, below those that the system gives to clients.
"""

import atexit
import errno
import itertools
import os
import socket

_FIRST, _LAST = 21_000, 32_700
_BLOCK = 40
_LOOPBACK = "127.0.0.1"


class SocketWithoutIpv6(socket.socket):
    """In place of `socket.socket`: that of a system without IPv6, as with the kernel's option ipv6.disable=1."""

    def __init__(self, family=-1, *others, **named):
        if family == socket.AF_INET6:
            raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
        super().__init__(family, *others, **named)


class _Numbers:
    """A block of numbers that is this process's as long as it lives."""

    def __init__(self):
        # A name that the system forgets with the process, whatever its end.
        self._claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # Else the interpreter may find it open when it ends, and say so.
        atexit.register(self._claim.close)
        blocks = (_LAST - _FIRST) // _BLOCK
        for turn in range(blocks):
            first = _FIRST + (os.getpid() + turn) % blocks * _BLOCK
            try:
                self._claim.bind(f"\0heliocube-tests-{first}")
            except OSError:
                continue
            self._turns = itertools.cycle(range(first, first + _BLOCK))
            return
        raise AssertionError("all ports for tests are taken")

    def next(self, kind):
        for number in itertools.islice(self._turns, _BLOCK):
            with socket.socket(socket.AF_INET, kind) as probe:
                try:
                    probe.bind((_LOOPBACK, number))
                except OSError:
                    continue
                return number
        raise AssertionError("all ports of this process are in use")


_numbers: _Numbers | None = None


def take_block():
    """Take this process's block, as is best done before any test may be said to have left it open."""
    global _numbers
    if _numbers is None:
        _numbers = _Numbers()
    return _numbers


def free_port(kind=socket.SOCK_STREAM):
    """Return the number of a port on loopback that is free, and stays so for whoever binds it in this test.

    Parameters
    ----------
    kind
        Of socket: a stream's or datagrams'.
    """
    return take_block().next(kind)
