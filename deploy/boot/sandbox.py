"""Points about what the units may not do, tried from inside of them."""

import json
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from boot.emulated import EmulatedMachine
from boot.host import CheckFailed, CheckSkipped
from boot.machine import FOREIGN, Machine
from boot.rig import TRACKER, UNITS

MOST_EXPOSED = 1.5
# A device that the service has no use for: it stands for a disk, a console, a stranger's serial line.
DEVICE = "/dev/foreign"
PORT = 20599
# The last two errors come from what lies behind a device that could be opened.
_OPEN = {"allowed", "No such device or address", "No such device"}

_LIFE = ("Type", "NotifyAccess", "ExecStart", "Restart", "RestartSec", "WatchdogSec", "StandardOutput", "StandardError")

PROBE = f"""
import json, os, socket, sys
def told(act):
    try:
        act()
    except OSError as error:
        return error.strerror
    return "allowed"
def make_folder():
    os.mkdir("/opt/heliocube/probe")
    os.rmdir("/opt/heliocube/probe")
def connect(host):
    def act():
        with socket.create_connection((host, {PORT}), 3):
            pass
    return act
print(json.dumps(dict(
    etc=told(lambda: open("/etc/heliocube/tracker.toml", "a").close()),
    program=told(make_folder),
    own=told(lambda: open("/var/lib/heliocube/probe", "w").close()),
    terminal=told(lambda: open(sys.argv[1], "rb+", 0).close()),
    device=told(lambda: open("{DEVICE}", "rb", 0).close()),
    home=told(lambda: os.listdir("/root")),
    packet=told(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()),
    loopback=told(connect("127.0.0.1")),
    foreign=told(connect("{FOREIGN}")),
)), file=sys.stderr)
"""

SERVER = f"""
import socket
server = socket.create_server(("0.0.0.0", {PORT}))
while True:
    server.accept()[0].close()
"""


class Sandbox:
    """The lines of a unit that refuse, with another program in place of the service.

    Parameters
    ----------
    machine
        Booted.
    emulated
        For what the kernel enforces in no container here.
    """

    def __init__(self, machine: Machine, emulated: EmulatedMachine) -> None:
        self._machine = machine
        self._emulated = emulated

    def check_exposure(self) -> str:
        """`systemd-analyze security` of the loaded units."""
        rated = {}
        for unit in UNITS:
            said = self._machine.run("systemd-analyze", "--no-pager", "security", unit).splitlines()[-1]
            level = re.search(r"exposure level.*: ([\d.]+)", said)
            if level is None or not float(level[1]) <= MOST_EXPOSED:
                raise CheckFailed(said)
            rated[unit] = level[1]
        return f"exposure {' and '.join(rated.values())} of 10, at most {MOST_EXPOSED}"

    def prepare(self) -> None:
        """Write the probe, and start the listener that it tries to reach."""
        self._machine.write("/opt/probe.py", PROBE)
        self._machine.write("/opt/server.py", SERVER)
        self._machine.run("systemd-run", "--quiet", "--unit=probe-server", "python3", "/opt/server.py")

    def check_access(self) -> str:
        """See that the tracker's unit cannot reach what it has no use for."""
        found = self._try("tracker", self._unit_text(TRACKER))
        if found["own"] != "allowed" or found["loopback"] != "allowed":
            raise CheckFailed(f"the service could not work: {found}")
        tried = ("etc", "program", "terminal", "home", "packet")
        if open_doors := [name for name in tried if found[name] == "allowed"]:
            raise CheckFailed(f"allowed: {', '.join(open_doors)}")
        if found["program"] != "Read-only file system":
            raise CheckFailed(
                f"only rights and no read-only file system keep it from its own program: {found['program']}"
            )
        return ", ".join(f"{name}: {found[name]}" for name in tried)

    def check_addresses(self) -> str:
        """See that IPAddressDeny refuses an address outside private networks."""
        see = partial(self._refuse_by, "foreign", "IPAddressDeny=any", f"connecting to {FOREIGN}")
        return self._here_or_emulated(see, self._emulated.check_addresses)

    def check_devices(self) -> str:
        """See that DevicePolicy refuses a device of a class that the unit does not name, whatever its mode."""
        return self._here_or_emulated(self._refuse_device, self._emulated.check_devices)

    def _here_or_emulated(self, here: Callable[[], str], emulated: Callable[[Mapping[str, str]], str]) -> str:
        try:
            return here()
        except CheckSkipped as why:
            try:
                seen = emulated({unit: self._unit_text(unit) for unit in UNITS})
            except CheckSkipped as why_not:
                raise CheckSkipped(f"{why}; {why_not}") from None
            return f"under qemu, since {why}: {seen}"

    def _refuse_device(self) -> str:
        made = self._machine.run_unchecked("sh", "-c", f"test -e {DEVICE} || mknod -m 0666 {DEVICE} c 204 64")
        if made.returncode != 0:
            raise CheckSkipped(f"no device can be made in a container here: {made.stderr.strip()}")
        return self._refuse_by("device", "DevicePolicy=closed", f"opening {DEVICE}")

    def _refuse_by(self, name: str, line: str, act: str) -> str:
        """Try without any line, with the unit's lines and, if that is allowed, with one line alone: is it enforced."""
        bare = "[Service]\n"
        if (free := self._try("free", bare)[name]) not in _OPEN:
            raise CheckSkipped(f"nobody can do it in a container here, sandbox or not; {act}: {free}")
        if (seen := self._try("tracker", self._unit_text(TRACKER))[name]) not in _OPEN:
            return f"{act}: {seen}; without the unit's lines it is allowed"
        if self._try("bare", f"{bare}{line}\n")[name] in _OPEN:
            raise CheckSkipped(f"in a container here the kernel enforces {line} for no unit at all")
        raise CheckFailed(f"{act}: {seen}")

    def _unit_text(self, unit: str) -> str:
        return self._machine.run("cat", self._machine.show(unit, "FragmentPath")["FragmentPath"])

    def _try(self, name: str, unit: str) -> dict[str, str]:
        """Run the probe with a unit's lines, except those about its life, and return what it was told."""
        lines = [line for line in unit.splitlines() if line.partition("=")[0] not in _LIFE]
        at = lines.index("[Service]") + 1
        terminal = "/dev/pts/0"
        lines[at:at] = ["Type=oneshot", "StandardError=journal", f"ExecStart=/usr/bin/python3 /opt/probe.py {terminal}"]
        probe = f"probe-{name}.service"
        Path(self._machine.root / "etc/systemd/system" / probe).write_text("\n".join(lines) + "\n", encoding="utf-8")
        self._machine.systemctl("daemon-reload")
        self._machine.systemctl("start", probe)
        said = [entry["MESSAGE"] for entry in self._machine.journal_entries(f"_SYSTEMD_UNIT={probe}", "--lines=20")]
        found: dict[str, str] = json.loads(next(line for line in reversed(said) if str(line).startswith("{")))
        return found
