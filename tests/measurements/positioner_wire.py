"""What listening to one POZSOL on a serial line costs a process: CPU time per second, at rest and under way.

Usage: python tests/measurements/positioner_wire.py [seconds]

Another process prints the simulated unit's screens onto a pseudo-terminal, one every 20 ms as the unit does. This one
reads and parses them as `run` does, and does nothing else.
"""

import multiprocessing
import os
import platform
import sys
import time
import tty

from drivers.positioners.pozsol.link import open_port
from drivers.positioners.pozsol.stream import TelemetryReader
from drivers.positioners.pozsol.wire import STOP, Field, encode_command
from sim_drivers.pozsol.core import PositionerCore

SCREEN_S = 0.02
SETTLES_S = 8.0
TURNS_S = 10.0


def print_screens(descriptor: int, *, moves: bool) -> None:
    """Write screens until killed; `moves` sends the unit to and fro."""
    begun_s = time.monotonic()
    core, now_s, turned_s, high = PositionerCore(), 0.0, -TURNS_S, False
    core.feed(encode_command(Field.ACTION, STOP), now_s)
    while True:
        if moves and now_s - turned_s > TURNS_S:
            turned_s, high = now_s, not high
            core.feed(encode_command(Field.A_ANGLE, 20.0 if high else -20.0), now_s)
        os.write(descriptor, core.next_screen(now_s))
        now_s += SCREEN_S
        time.sleep(max(begun_s + now_s - time.monotonic(), 0.0))


def cost(seconds: float, *, moves: bool) -> float:
    """Return the share of a core [ms/s] that reading takes."""
    unit, line = os.openpty()
    tty.setraw(line)
    context = multiprocessing.get_context("fork")
    printing = context.Process(target=print_screens, args=(unit,), kwargs={"moves": moves}, daemon=True)
    printing.start()
    reader = TelemetryReader(open_port(os.ttyname(line)), time.monotonic)
    time.sleep(SETTLES_S)
    begun_s, cpu_s = time.monotonic(), time.process_time()
    time.sleep(seconds)
    share = (time.process_time() - cpu_s) / (time.monotonic() - begun_s)
    if reader.lost or not reader.heard:
        sys.exit(f"nothing was measured: {reader.lost or 'no screen has come'}")
    reader.close()
    printing.kill()
    printing.join()
    os.close(unit)
    os.close(line)
    return 1000.0 * share


def main(seconds: float = 30.0) -> None:
    """Print the cost at rest and under way."""
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
          f"load {os.getloadavg()[0]:.1f} before")  # fmt: skip
    for name, moves in (("at rest", False), ("on its way", True)):
        print(f"{name}: {cost(seconds, moves=moves):.2f} ms/s")


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
