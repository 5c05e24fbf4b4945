"""A network of a test's own, in this process: its addresses can come and go, and those of loopback cannot."""

import ctypes
import os
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

# unshare(2), <linux/sched.h>
_CLONE_NEWNET = 0x40000000


def in_own_network(work: Callable[[], None]) -> None:
    """Run `work` in a thread whose sockets and programs have a network of their own, with 127.0.0.1 and nothing else.

    Needs what `tests.support.bad_network.why_no_namespaces` asks for. Raises what `work` raises.
    """

    def within() -> None:
        # For this thread only; the network vanishes with it.
        if ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        _ip("link", "set", "lo", "up")
        work()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(within).result()


def add_address(address: str) -> None:
    """Give this thread's network an address."""
    _ip("address", "add", f"{address}/32", "dev", "lo")


def remove_address(address: str) -> None:
    """Take an address from this thread's network."""
    _ip("address", "del", f"{address}/32", "dev", "lo")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)
