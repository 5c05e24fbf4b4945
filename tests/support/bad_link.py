"""A bad link between two network interfaces: it carries frames over, and loses, doubles, delays and cuts.

``python tests/support/bad_link.py LEFT RIGHT SEED``, in a network namespace that has both ends. Each line of its input
is a JSON object that changes the link from then on: ``loss``, ``duplicate`` and ``reorder`` (shares of the frames),
``delay_s`` and ``jitter_s`` (drawn for each frame, so that jitter reorders too), ``cut`` (true: nothing passes). A
reordered frame comes 50 ms later. ARP is neither lost nor doubled: without it there would be no link at all. It does
what the kernel's netem does, on kernels built without netem, and repeatably by a seed.
"""

import heapq
import itertools
import json
import random
import select
import socket
import sys
import time

_ALL = 3
_SOL_PACKET, _PACKET_VNET_HDR = 263, 15
_KIND = slice(10 + 12, 10 + 14)
_ARP = b"\x08\x06"
_HELD_S = 0.05


class BadLink:
    """Frames on their way, each with the time at which it arrives."""

    def __init__(self, seed: int) -> None:
        self.conditions = {"loss": 0.0, "duplicate": 0.0, "reorder": 0.0, "delay_s": 0.0, "jitter_s": 0.0, "cut": False}
        self._choice = random.Random(seed)
        self._under_way: list[tuple[float, int, socket.socket, bytes]] = []
        self._numbers = itertools.count()

    def take(self, frame: bytes, towards: socket.socket, now_s: float) -> None:
        """Lose, double or delay a frame."""
        how, choice = self.conditions, self._choice
        if how["cut"] or (frame[_KIND] != _ARP and choice.random() < how["loss"]):
            return
        for _ in range(2 if frame[_KIND] != _ARP and choice.random() < how["duplicate"] else 1):
            due_s = now_s + how["delay_s"] + how["jitter_s"] * choice.random()
            if choice.random() < how["reorder"]:
                due_s += _HELD_S
            heapq.heappush(self._under_way, (due_s, next(self._numbers), towards, frame))

    def deliver(self, now_s: float) -> float | None:
        """Hand over the frames that are due; return the time until the next [s], or None."""
        while self._under_way and self._under_way[0][0] <= now_s:
            _, _, towards, frame = heapq.heappop(self._under_way)
            try:
                towards.send(frame)
            except OSError as error:
                print(f"a frame was dropped: {error}", file=sys.stderr)
        return self._under_way[0][0] - now_s if self._under_way else None


def main(left: str, right: str, seed: str) -> None:
    """Carry frames until standard input ends."""
    ends = []
    for name in (left, right):
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL))
        # The kernel left the checksums to the device. The header says so; without it the far end refuses every frame.
        end.setsockopt(_SOL_PACKET, _PACKET_VNET_HDR, 1)
        end.bind((name, 0))
        end.setblocking(False)
        ends.append(end)
    link, others = BadLink(int(seed)), {ends[0]: ends[1], ends[1]: ends[0]}
    print("ready", flush=True)
    while True:
        readable, _, _ = select.select([sys.stdin, *ends], [], [], link.deliver(time.monotonic()))
        for source in readable:
            if source is sys.stdin:
                line = sys.stdin.readline()
                if not line:
                    return
                link.conditions.update(json.loads(line))
                print("ready", flush=True)
                continue
            frame, (_, _, kind, *_) = source.recvfrom(65536)
            if kind != socket.PACKET_OUTGOING:
                link.take(frame, others[source], time.monotonic())


if __name__ == "__main__":
    main(*sys.argv[1:])
