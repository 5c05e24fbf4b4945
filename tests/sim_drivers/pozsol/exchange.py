"""What tests send to the simulated unit, and how they read what it shows."""

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, TokenStream, encode_command, parse_status
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles

STOP = encode_command(Field.ACTION, wire.STOP)
CLEAR = encode_command(Field.STATUS, wire.CLEAR)
HOME_A = encode_command(Field.ACTION, wire.HOME_A)
HOME_B = encode_command(Field.ACTION, wire.HOME_B)
TRACKING_OFF = encode_command(Field.MODE, wire.TRACKING_OFF)
JOG_A_OUT = b"$92\r"


def fields(core, now):
    return dict(TokenStream().feed(core.screens(now) + b"$"))


def number(core, field, now):
    return float(fields(core, now)[field])


def status(core, now):
    return parse_status(fields(core, now)[Field.STATUS].decode(), wire.B_OUT_BIT_STM)


def moves(core, now, axis="a"):
    """Whether the status says that an axis moves, in or out."""
    first = {"a": wire.A_OUT_BIT, "b": wire.B_OUT_BIT_STM}[axis]
    return bool(status(core, now).word >> first & 0b11)


def point(core, now, a_deg=None, b_deg=None):
    if a_deg is not None:
        core.feed(encode_command(Field.A_ANGLE, a_deg), now)
    if b_deg is not None:
        core.feed(encode_command(Field.B_ANGLE, b_deg), now + 0.06)
    return now + 0.12


def own(**changes):
    return Setup(own_target=lambda now: Angles(-30.0 + now / 100.0, 60.0), **changes)
