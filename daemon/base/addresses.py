"""Numeric socket addresses, as the settings write them. Names are not resolved: that would block the event loop."""

import errno
import ipaddress
import re
import socket
import struct
from dataclasses import dataclass

from daemon.base.errors import UserError

_FORM = re.compile(r"\[(?P<v6>[^\[\]]*)\]:(?P<port6>[0-9]{1,5})|(?P<v4>[^:\[\]]*):(?P<port4>[0-9]{1,5})", re.ASCII)

ANY_INTERFACE = "0.0.0.0"  # noqa: S104 - the kernel's word for its own choice
DROP_UNSENT_ON_CLOSE = socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
"""Option of a socket: closing it drops the bytes that have not been delivered yet, as on a stalled network."""


class BridgeError(UserError):
    """The bridge cannot work as it is set up; the message is one sentence for the operator."""


@dataclass(frozen=True, slots=True)
class Address:
    """An IP address and a port."""

    host: str
    port: int

    @property
    def ip(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
        """The host as a number."""
        return ipaddress.ip_address(self.host)

    @property
    def reachable_address(self) -> "Address":
        """The address by which this machine reaches a listener here: loopback if it listens on all networks."""
        if not self.ip.is_unspecified:
            return self
        return Address("::1" if self.ip.version == 6 else "127.0.0.1", self.port)

    @property
    def family(self) -> socket.AddressFamily:
        """The socket family of the host."""
        return socket.AF_INET6 if self.ip.version == 6 else socket.AF_INET

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """Return the address that `text` writes as ``192.168.1.20:20571`` or ``[fd00::20]:20571``; port 0 is allowed.

    Raises
    ------
    ValueError
        With one sentence that quotes the text and shows a right one.
    """
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"{text!r} is not an address and a port, such as 192.168.1.20:20571 or [fd00::20]:20571")
    version = 6 if found["v6"] is not None else 4
    port = int(found["port6"] or found["port4"])
    if port > 65535:
        raise ValueError(f"{text!r} has port {port}, and the highest port is 65535")
    host = found["v6"] if version == 6 else found["v4"]
    try:
        ip = ipaddress.ip_address(host)
    except ValueError:
        ip = None
    if ip is None or ip.version != version or "%" in host:
        raise ValueError(
            f"{text!r} does not begin with a numeric address, such as 192.168.1.20:20571 or [fd00::20]:20571"
            " (host names and link-local zones are not resolved)"
        )
    return Address(str(ip), port)


def is_local_address(address: Address) -> bool:
    """Return whether an address is on this machine now, so that one can listen on it; its ports are not looked at."""
    try:
        with socket.socket(address.family, socket.SOCK_DGRAM) as asking:
            asking.bind((address.host, 0))
    except OSError as error:
        return error.errno != errno.EADDRNOTAVAIL
    return True


def unmap_ipv4(host: str) -> str:
    """Return an IPv4 address that IPv6 has wrapped, such as ``::ffff:192.0.2.2``, as IPv4, and any other as it is."""
    mapped = getattr(ipaddress.ip_address(host), "ipv4_mapped", None)
    return host if mapped is None else str(mapped)


def require_key(key: bytes | None, *, insecure: bool) -> None:
    """Raise `BridgeError` when there is no key, unless the settings say that none is wanted."""
    if key is None and not insecure:
        raise BridgeError(
            "bridge.key_file is not set: make a key with 'heliocube config init', or, in a closed lab only, set"
            " bridge.insecure = true"
        )


DEFAULT_LISTEN = "127.0.0.1:20572"
CUBE_LISTEN = "127.0.0.1:20573"
DEFAULT_DASHBOARD = "127.0.0.1:20574"
