"""What runs in the emulated machine: its own first unit, and the program in the place of the services'."""

import json
from collections.abc import Mapping

from boot import machine

FOREIGN = machine.FOREIGN
OWN = "127.0.0.1"
# A second serial line: real, of no class that the units name, and opened to everybody.
DEVICE = "/dev/ttyS1"
MARK = "heliocube-probe: "
ADDRESSES, DEVICES = "IPAddress", "Device"
OMITTED_LINE_PREFIXES = ("", ADDRESSES, DEVICES)
"""How the lines begin that each copy of a unit is without; the first copy is the unit as it is."""

_PORT = 20599

TARGET = """
[Unit]
Requires=basic.target probe.service
After=basic.target probe.service
AllowIsolate=yes
"""

SERVICE = """
[Unit]
After=basic.target
[Service]
Type=oneshot
ExecStart=/usr/bin/python3 -I /opt/guest.py
"""

DROP_IN = """
[Service]
Type=oneshot
Restart=no
ExecStart=
ExecStart=/usr/bin/python3 -I /opt/probe.py
StandardError=truncate:/run/probe-%n
"""
"""What is changed in a unit: its program and how that lives, but no line that refuses something."""

PROBE = f"""
import json, os, socket, sys
def told(act, *words):
    try:
        act(*words)
    except OSError as error:
        return error.strerror or str(error)
    return "allowed"
def send(host):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"?", (host, {_PORT + 1}))
def open_device():
    os.close(os.open("{DEVICE}", os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY))
def hear():
    # The foreign one speaks before each word of the own one.
    heard = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.settimeout(20)
        listener.bind(("0.0.0.0", {_PORT}))
        while heard.count("{OWN}") < 3:
            try:
                heard.append(listener.recvfrom(9)[1][0])
            except OSError as error:
                return [str(error)]
    return sorted(set(heard))
answers = dict(own=told(send, "{OWN}"), foreign=told(send, "{FOREIGN}"), heard=hear(), device=told(open_device))
print(json.dumps(answers), file=sys.stderr)
"""


def guest_program(units: Mapping[str, Mapping[str, str]]) -> str:
    """Return the program of the machine's own unit: it adds the foreign address, starts units and says what they saw.

    Parameters
    ----------
    units
        Names of units to start, by unit and by the lines that they are without.
    """
    return f"""
import fcntl, json, os, socket, struct, subprocess, threading, time
def say(text):
    with open("/dev/console", "w") as console:
        console.write("\\n{MARK}" + text + "\\n")
def speak():
    senders = []
    for host in ("{FOREIGN}", "{OWN}"):
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sender.bind((host, 0))
        senders.append((sender, host))
    while True:
        for sender, host in senders:
            sender.sendto(b"!", (host, {_PORT}))
        time.sleep(0.05)
def start(name):
    done = subprocess.run(["systemctl", "start", name], capture_output=True, text=True)
    try:
        with open("/run/probe-" + name) as file:
            said = file.read()
        return json.loads(said.splitlines()[-1])
    except (OSError, ValueError, IndexError) as error:
        shown = subprocess.run(["systemctl", "status", "--no-pager", name], capture_output=True, text=True)
        return {{"error": " / ".join((str(error) + done.stderr + shown.stdout).splitlines())}}
say("begun")
try:
    subprocess.run(["systemd-sysusers"], check=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        # SIOCSIFADDR: the tree has no program for it.
        address = struct.pack("16sHxx4s16x", b"lo:1", socket.AF_INET, socket.inet_aton("{FOREIGN}"))
        fcntl.ioctl(any_socket, 0x8916, address)
    os.chmod("{DEVICE}", 0o666)
    threading.Thread(target=speak, daemon=True).start()
    units = json.loads({json.dumps(json.dumps(units))})
    say(json.dumps({{unit: {{key: start(name) for key, name in names.items()}} for unit, names in units.items()}}))
except Exception as error:
    say(repr(error))
os.sync()
subprocess.run(["systemctl", "poweroff", "--force", "--force"])
"""
