"""A broker in a process of its own, which a test may kill, hang and start again: mosquitto, or else amqtt."""

import asyncio
import contextlib
import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from tests.support import PATIENCE_S, ROOT
from tests.support.addresses import free_port

_PATHS = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
MOSQUITTO = None if os.environ.get("HELIOCUBE_TEST_BROKER") == "amqtt" else shutil.which("mosquitto", path=_PATHS)
UNTESTED_WITH_AMQTT = "wrong passwords, access lists, TLS and the takeover of a client id"
CERTIFICATES = Path(__file__).parent / "certificates"


class Broker:
    """One broker on a loopback port of its own."""

    def __init__(
        self,
        folder,
        users=None,
        acl=None,
        tls=False,
        most_bytes=None,
        unsaid_most_bytes=None,
        certificate="broker",
        setting="",
    ):
        self.port = free_port()
        self.process = None
        self._folder = folder
        self._arguments = (
            self._mosquitto(users, acl, tls and certificate, most_bytes, unsaid_most_bytes, setting)
            if MOSQUITTO
            else [sys.executable, "-m", "tests.support.broker", str(self.port)]
        )

    def _mosquitto(self, users, acl, certificate, most_bytes, unsaid_most_bytes, setting):
        lines = [f"listener {self.port} 127.0.0.1", setting, "persistence false", f"user {getpass.getuser()}"]
        lines.append("max_queued_messages 0")
        lines.append(f"allow_anonymous {'false' if users else 'true'}")
        if most_bytes:
            lines.append(f"max_packet_size {most_bytes}")
        if unsaid_most_bytes:
            lines.append(f"message_size_limit {unsaid_most_bytes}")
        if users:
            passwords = self._folder / "passwords"
            passwords.write_text("".join(f"{user}:{word}\n" for user, word in users.items()))
            passwords.chmod(0o600)
            subprocess.run(["mosquitto_passwd", "-U", str(passwords)], check=True, capture_output=True)
            lines.append(f"password_file {passwords}")
        if acl:
            path = self._folder / "acl"
            path.write_text(acl)
            path.chmod(0o600)
            lines.append(f"acl_file {path}")
        if certificate:
            lines += [
                f"cafile {CERTIFICATES / 'ca.pem'}",
                f"certfile {CERTIFICATES / certificate}.pem",
                f"keyfile {CERTIFICATES / 'broker.key'}",
                "require_certificate true",
            ]
        path = self._folder / "mosquitto.conf"
        path.write_text("\n".join(lines) + "\n")
        return [MOSQUITTO, "-c", str(path)]

    def start(self):
        with (self._folder / "broker.log").open("a") as log:
            self.process = subprocess.Popen(self._arguments, cwd=ROOT, stdout=log, stderr=log)
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return self
            time.sleep(0.01)
        raise AssertionError((self._folder / "broker.log").read_text())

    def kill(self):
        self.process.kill()
        self.process.wait()

    def hang(self):
        self.process.send_signal(signal.SIGSTOP)

    def resume(self):
        self.process.send_signal(signal.SIGCONT)

    def close(self):
        if self.process is not None and self.process.poll() is None:
            self.kill()


async def _amqtt(port):
    from amqtt.broker import Broker as Embedded  # noqa: PLC0415 - only where there is no mosquitto

    plugins = {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}
    listener = {"type": "tcp", "bind": f"127.0.0.1:{port}", "max_connections": 50}
    broker = Embedded({"listeners": {"default": listener}, "plugins": plugins})
    await broker.start()
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_amqtt(int(sys.argv[1])))
