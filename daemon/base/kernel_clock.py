"""What the kernel says of the machine's clock: whether anything has synchronised it."""

import ctypes
import sys

# Setting the clock raises the bound of its error to this. A program that synchronises it lowers the bound, even a
# chrony that leaves the flag for unsynchronised clocks alone (without `rtcsync`). `timedatectl` goes by the bound, too.
_UNSYNCHRONISED_ERROR_US = 16_000_000


class _Timex(ctypes.Structure):
    """The beginning of Linux' ``struct timex``, and room for the rest, which is written too."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_char * 512),
    )


def synchronised() -> bool | None:
    """Return whether the kernel counts its clock as synchronised; None where it cannot be asked. Changes nothing."""
    if not sys.platform.startswith("linux"):
        return None
    found = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(found))
    except (OSError, AttributeError):
        return None
    return None if state < 0 else found.maxerror < _UNSYNCHRONISED_ERROR_US
