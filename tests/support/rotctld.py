"""Hamlib's own rotctld in a process of its own, which a test may kill, hang and start again."""

import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

from tests.support import PATIENCE_S
from tests.support.addresses import free_port

ROTCTLD = shutil.which("rotctld")
LEFT_OUT = "rotctld is not here (libhamlib-utils): the tests against Hamlib's own server are left out"


class Rotctld:
    """The dummy rotator of Hamlib, 6 deg/s on both axes, on a loopback port of its own."""

    def __init__(self, *options):
        self.port = free_port()
        self.options = options
        self.process = None

    @property
    def place(self):
        return f"127.0.0.1:{self.port}"

    def start(self):
        """Start it, at azimuth 0, elevation 0, and wait until it answers."""
        arguments = [ROTCTLD, "-m", "1", "-T", "127.0.0.1", "-t", str(self.port), *self.options]
        self.process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.ask("+p\n", b"RPRT")
            except OSError:
                assert time.monotonic() < deadline_s, "rotctld does not start"
                time.sleep(0.02)
            else:
                return

    def connect(self):
        """Return a second client's connection: rotctld now and then resets one that begins while another ends."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)

    def ask(self, text, until=None):
        """Send text as another client, and return the answer up to a mark, or all of it."""
        with self.connect() as peer:
            peer.sendall(text.encode())
            if until is None:
                # rotctld closes the connection when it has answered everything from a client that sends no more.
                peer.shutdown(socket.SHUT_WR)
            heard = b""
            while until is None or until not in heard:
                try:
                    piece = peer.recv(4096)
                except TimeoutError:
                    break
                if not piece:
                    break
                heard += piece
        return heard

    def azimuth_deg(self):
        """Return the azimuth that another client is told [deg]."""
        return float(self.ask("p\n", b".").split(b"\n")[0])

    def kill(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def hang(self):
        """Freeze it, and return when every thread of it has stopped: until then it may still answer."""
        self.process.send_signal(signal.SIGSTOP)
        deadline_s = time.monotonic() + PATIENCE_S
        while any(_state(stat) != "T" for stat in Path(f"/proc/{self.process.pid}/task").glob("*/stat")):
            assert time.monotonic() < deadline_s, "rotctld does not stop"
            time.sleep(0.005)

    def resume(self):
        self.process.send_signal(signal.SIGCONT)


def _state(stat):
    try:
        return stat.read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        # A thread that has ended cannot answer either.
        return "T"
