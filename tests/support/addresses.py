"""Port numbers for the servers of tests, which no other worker, run or client gets meanwhile.

A port that was free a moment ago may be the local end of some client's connection a moment later, or may be handed to
another test as free. So each process of tests has a block to itself, below the range that the system gives to clients.
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
    """Stands in for `socket.socket` on a system without IPv6, as with the kernel's option ipv6.disable=1."""

    def __init__(self, family=-1, *others, **named):
        if family == socket.AF_INET6:
            raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
        super().__init__(family, *others, **named)


class _Numbers:
    """A block of numbers that belongs to this process as long as it lives."""

    def __init__(self):
        # The system frees this name when the process ends, however it ends.
        self._claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # Otherwise the interpreter may find the socket open at its end, and warn.
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


def reserve_port_block():
    """Take this process's block: before any test, or the leak check would find the socket that holds it."""
    global _numbers
    if _numbers is None:
        _numbers = _Numbers()
    return _numbers


def free_port(kind=socket.SOCK_STREAM):
    """Return the number of a port on loopback that is free, and stays so until this test binds it.

    Parameters
    ----------
    kind
        Of socket: for streams or for datagrams.
    """
    return reserve_port_block().next(kind)
