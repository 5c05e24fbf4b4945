"""The scans of a cube, and receivers that a test drives: one without a socket, and one on a real port."""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import asdict, replace

from daemon.base.addresses import parse_address
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge import senml, signing
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.links import BridgeSettings
from tests.support import PATIENCE_S

KEY = bytes(range(1, 33))
UTC_S = 1665742815.0
PEER = ("127.0.0.1", 40000)
SETTINGS = BridgeSettings(listen="127.0.0.1:0")


class HandClock:
    """The receiver's clock, moved by the test; its UTC may be set independently."""

    def __init__(self):
        self.now_s = 1000.0
        self.utc_offset_s = UTC_S

    def monotonic(self):
        return self.now_s

    def utc(self):
        return self.now_s - 1000.0 + self.utc_offset_s


def scan(sequence=0, time_s=None, **changes):
    """Return the scan that a cube finishes `time_s` seconds (5 per number by default) after the test's beginning."""
    time_s = 5.0 * sequence if time_s is None else time_s
    utc_s, steady_s = UTC_S + time_s, 70.0 + time_s
    east, south, west, zenith = (
        FaceReading(100.0 + i, Quality.OK, utc_s - age_s, steady_s - age_s)
        for i, age_s in enumerate((0.75, 0.5, 0.25, 0.0))
    )
    return replace(Scan("cube", "first", sequence, utc_s, steady_s, east, south, west, zenith), **changes)


def signed(sent, key=KEY):
    return signing.sign(senml.encode(sent), key)


GOOD = signed(scan())


def place_of(receiver):
    address = parse_address(receiver.address)
    return address.host, address.port


class Desk:
    """A receiver without a socket: datagrams are handed in, each at its own time."""

    def __init__(self, key=KEY, **settings):
        self.clock = HandClock()
        self.scans = []
        self.receiver = BridgeReceiver(BridgeSettings(**settings), key, self.clock, self.scans.append)

    def take(self, datagram, time_s=None, peer=PEER):
        if time_s is not None:
            self.clock.now_s = 1000.0 + time_s
        self.receiver.datagram_received(datagram, peer)

    def follow(self, *scans):
        """Take each scan at the instant when it was made."""
        for sent in scans:
            self.take(signed(sent), sent.time_monotonic_s - 70.0)

    @property
    def counts(self):
        """The counters that are not zero."""
        return {
            name: value for name, value in asdict(self.receiver.statistics).items() if isinstance(value, int) and value
        }

    @property
    def reason(self):
        return self.receiver.statistics.last_refusal


async def until_examined(receiver, expected):
    """Let the loop run until the receiver has examined so many datagrams."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            counts = receiver.statistics
            if counts.accepted + counts.refused >= expected:
                return
            await asyncio.sleep(0)


@asynccontextmanager
async def port(settings=SETTINGS, key=KEY):
    """An open receiver on a real port, its clock, its scans, and a function that waits for a number of datagrams."""
    clock, scans = HandClock(), []
    receiver = BridgeReceiver(settings, key, clock, scans.append)

    async def settle(expected):
        await until_examined(receiver, expected)

    await receiver.open()
    try:
        yield receiver, clock, scans, settle
    finally:
        await receiver.close()
