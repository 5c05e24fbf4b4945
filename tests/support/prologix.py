"""A Prologix GPIB-USB adapter on a pseudo-terminal."""

import math
import os
import re
import threading
import time
import tty
from collections import deque

from tests.support import PATIENCE_S


class Prologix(threading.Thread):
    """A GPIB-USB adapter with a simulated meter at address 16: a controller that lets the meter talk when told to.

    The factory setting is ``++auto 1``: it reads after every line, which hangs a meter that has nothing to say.
    """

    def __init__(self, core, link):
        super().__init__(daemon=True)
        self._core = core
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self.settings = {"mode": "0", "auto": "1", "addr": "5", "eoi": "0"}
        self.clears = self.stuck = self.lines = 0
        self.start()

    def run(self):
        said, data = deque(), b""
        while True:
            try:
                data += os.read(self._master, 256)
            except OSError:
                return
            while b"\n" in data:
                line, _, data = data.partition(b"\n")
                self.lines += 1
                if line == b"end":
                    return
                if line.startswith(b"++"):
                    self._obey(line[2:].decode().split(), said)
                elif (self.settings["mode"], self.settings["addr"]) == ("1", "16"):
                    text = re.sub(rb"\x1b(.)", rb"\1", line)
                    said.extend(self._core.feed(text + b"\n", time.monotonic()))
                    self.stuck += self.settings["auto"] == "1" and not said

    def _obey(self, order, said):
        if order == ["read", "eoi"]:
            if self._comes_in_time(said[0][0] if said else math.inf):
                os.write(self._master, said.popleft()[1])
        elif order == ["clr"]:
            said.clear()
            self.clears += 1
        elif len(order) == 2:
            self.settings[order[0]] = order[1]

    def _comes_in_time(self, due_s):
        wait_s = max(due_s - time.monotonic(), 0.0)
        longest_s = int(self.settings["read_tmo_ms"]) / 1000
        time.sleep(min(wait_s, longest_s))
        return wait_s <= longest_s

    def end(self):
        os.write(self._slave, b"end\n")
        self.join(PATIENCE_S)
        os.close(self._slave)
        os.close(self._master)
