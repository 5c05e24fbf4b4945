"""How late a byte comes through a pseudo-terminal while other processes have several shares of the processors.

    python -m tests.measurements.shares [--seconds 15]

A thread of the kernel carries what is written to a pseudo-terminal. Twelve processes run, half of which always compute
and half of which wake every half millisecond. Meanwhile a byte is sent every 20 ms, and those that come later than
200 ms are counted: with the session's default share and with the smaller one of `make test`, each with equal and with
unequal shares of the processes. The session's share is set back at the end.
"""

import argparse
import os
import struct
import subprocess
import sys
import threading
import time
import tty

from tests.support.passes import SMALL_SHARE, session_share

LATE_S = 0.2
EVERY_S = 0.02
COMPUTES = "while True: pass"
BEGINS_ANEW = "import time\nwhile True:\n    time.sleep(0.0005)\n    sum(range(3000))"
SHARES = ((0, 0), (5, 0), (15, 0), (0, -10))
"""The shares, as `nice`, of the processes that compute and of those that wake."""


def measured(seconds):
    """Return how many bytes were sent, and the delays of the late ones [s]."""
    master, slave = os.openpty()
    tty.setraw(slave)
    late, sent = [], 0

    def receive():
        while moment := os.read(slave, 8):
            after_s = time.monotonic() - struct.unpack("d", moment)[0]
            if after_s < 0:
                return
            if after_s > LATE_S:
                late.append(after_s)

    receiver = threading.Thread(target=receive)
    receiver.start()
    end_s = time.monotonic() + seconds
    while (now_s := time.monotonic()) < end_s:
        os.write(master, struct.pack("d", now_s))
        sent += 1
        time.sleep(EVERY_S)
    os.write(master, struct.pack("d", float("inf")))
    receiver.join()
    os.close(slave)
    os.close(master)
    return sent, late


def main():
    """Measure and print one line for each pair of shares."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=15.0, help="how long each pair of shares is measured")
    seconds = parser.parse_args().seconds
    print(f"{os.cpu_count()} processors, {os.uname().release}")
    for session in (0, SMALL_SHARE):
        with session_share(session):
            for computing, beginning in SHARES:
                print(f"session {session}, {told(computing, beginning, seconds)}", flush=True)
        # Linux allows at most ten changes a second to a user who is not the administrator.
        time.sleep(0.2)


def told(computing, beginning, seconds):
    """Measure beside processes of two shares and return the outcome in words."""
    ordered = [(computing, COMPUTES)] * 6 + [(beginning, BEGINS_ANEW)] * 6
    beside = [subprocess.Popen(["nice", "-n", str(share), sys.executable, "-c", what]) for share, what in ordered]
    try:
        sent, late = measured(seconds)
    finally:
        for process in beside:
            process.kill()
            process.wait()
    return f"nice {computing} and {beginning}: {len(late)} of {sent} late, at most {max(late, default=0.0):.2f} s"


if __name__ == "__main__":
    main()
