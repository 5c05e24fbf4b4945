"""Check with Home Assistant itself, on the service's broker, that each entity shows a value and each button works.

Usage: python -m tests.measurements.home_assistant PYTHON [VERSION] [--with REQUIREMENT] [--keep-open]

Home Assistant is installed for the interpreter PYTHON in a temporary folder. Which Python it needs depends on its
version: 2024.11 needs 3.12 and "josepy<2", which it does not ask for itself; 2025.1 needs 3.13. The script sets it up
as a person does, with a user and the broker's address. Beside it run mosquitto and a service on the simulated rig at
real speed; all of them answer on loopback only. --keep-open waits at the end, so that the pages can be looked at.
"""

import argparse
import contextlib
import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

from tests.support import ROOT
from tests.support.addresses import free_port
from tests.support.broker import Broker

VERSION = "2025.1.4"
STARTS_WITHIN_S, SHOWN_WITHIN_S = 180.0, 60.0
NAME = "tracker (SIMULATED)"
# These have no value on a calm day before the first command; nor has a button before it is pressed.
UNKNOWN_AT_FIRST = {"Calm until release", "Last reply"}


def install(folder, python, version, others):
    """Install Home Assistant, and the exact versions that its MQTT integration and its pages ask for."""
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
    pip = [folder / "venv" / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, f"homeassistant=={version}", *others], check=True)
    (components,) = (folder / "venv").glob("lib/python3*/site-packages/homeassistant/components")
    asked = [json.loads((components / name / "manifest.json").read_text()) for name in ("mqtt", "frontend")]
    subprocess.run([*pip, "numpy", *(line for one in asked for line in one["requirements"])], check=True)


class HomeAssistant:
    """One Home Assistant with one user, spoken to over its HTTP API."""

    def __init__(self, folder, broker_port):
        self.url = f"http://127.0.0.1:{free_port()}"
        (folder / "config").mkdir()
        (folder / "config" / "configuration.yaml").write_text(
            "homeassistant:\n  name: lab\n  unit_system: metric\n  time_zone: UTC\n"
            f"http:\n  server_host: 127.0.0.1\n  server_port: {self.url.rsplit(':')[-1]}\n"
            "frontend:\nconfig:\nonboarding:\napi:\nlogger:\n  default: warning\n"
        )
        self.log = folder / "hass.log"
        with self.log.open("w") as log:
            command = [folder / "venv" / "bin" / "hass", "--config", folder / "config", "--skip-pip"]
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        self._web = httpx.Client(base_url=self.url, timeout=60, trust_env=False)
        self._log_in()
        flow = self.post("/api/config/config_entries/flow", {"handler": "mqtt"})
        if flow["type"] == "menu":
            flow = self.post(f"/api/config/config_entries/flow/{flow['flow_id']}", {"next_step_id": "broker"})
        there = {"broker": "127.0.0.1", "port": broker_port}
        done = self.post(f"/api/config/config_entries/flow/{flow['flow_id']}", there)
        if done["type"] != "create_entry":
            sys.exit(f"Home Assistant did not take the broker: {done}")

    def _log_in(self):
        user = {"client_id": self.url, "name": "a", "username": "a", "password": "a" * 12, "language": "en"}
        given = until(lambda: self._web.post("/api/onboarding/users", json=user), STARTS_WITHIN_S, "it has not started")
        code = {"grant_type": "authorization_code", "code": given.json()["auth_code"], "client_id": self.url}
        token = self._web.post("/auth/token", data=code).raise_for_status().json()["access_token"]
        self._web.headers["Authorization"] = f"Bearer {token}"

    def post(self, path, body):
        return self._web.post(path, json=body).raise_for_status().json()

    def states(self):
        """Return identifier and state of each entity of the device, by the entity's own name."""
        found = {}
        for one in self._web.get("/api/states").raise_for_status().json():
            name = one["attributes"].get("friendly_name", "")
            if name.startswith(NAME):
                found[name.removeprefix(NAME).strip()] = (one["entity_id"], one["state"])
        return found

    def press(self, name):
        self.post("/api/services/button/press", {"entity_id": self.states()[name][0]})

    def choose(self, option):
        where = self.states()["Command"][0]
        self.post("/api/services/select/select_option", {"entity_id": where, "option": option})

    def shows(self, within_s=SHOWN_WITHIN_S, **wanted):
        """Wait until entities show the wanted texts, or texts that begin so; `_` stands for a blank in their names."""

        def all_do():
            states = self.states()
            names = {name: name.replace("_", " ") for name in wanted}
            return all(names[name] in states and states[names[name]][1].startswith(wanted[name]) for name in wanted)

        until(all_do, within_s, lambda: f"{wanted} not within {within_s:g} s, but {self.states()}")


def until(call, within_s, otherwise):
    """Return the first true answer of `call`, or end the script with `otherwise`."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        with contextlib.suppress(httpx.HTTPError):
            if answer := call():
                return answer
        time.sleep(0.5)
    sys.exit(otherwise if isinstance(otherwise, str) else otherwise())


def serve(folder, broker_port, *, dated):
    """Start a service at a place where it is noon: with the true time, against which dated commands are checked."""
    noon_deg = 180.0 - time.time() / 86400.0 % 1.0 * 360.0
    (folder / "heliocube.toml").write_text(
        f"[site]\nlatitude_deg = 0.0\nlongitude_deg = {noon_deg:.1f}\n"
        '[bridge]\nlisten = "127.0.0.1:0"\ninsecure = true\n[api]\nlisten = "127.0.0.1:0"\n'
        '[simulation]\nspeed = 1.0\nweather = "clear"\n'
        f'[mqtt]\nenabled = true\nhost = "127.0.0.1"\nport = {broker_port}\ndated_commands = {str(dated).lower()}\n'
    )
    command = [Path(sys.executable).with_name("heliocube"), "run", "--config", folder / "heliocube.toml"]
    with (folder / "service.log").open("a") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, cwd=ROOT)


def look(home):
    """Print the entities that appear, and end the script if one has no value."""
    home.shows(Mode="tracking", Command="auto", Positioner="on", Cube_readings="off", Alarm="off")
    states = home.states()
    for name, (entity, state) in sorted(states.items()):
        print(f"  {entity.split('.')[0]:13s} {name:25s} {state}")
    silent = {
        name
        for name, (entity, state) in states.items()
        if state in ("unknown", "unavailable") and not entity.startswith("button.")
    }
    if silent - UNKNOWN_AT_FIRST:
        sys.exit(f"no value: {silent - UNKNOWN_AT_FIRST}")


def command(home):
    """Give every command that Home Assistant has, and check each in the states."""
    home.press("Stop")
    home.shows(Mode="hold", Reason="stopped by MQTT", Command="hold", Last_reply="stop: ")
    home.choose("stow")
    home.shows(Last_reply="mode refused: no stow: the tracker is stopped")
    home.choose("auto")
    home.shows(Mode="tracking", Reason="the cube's readings are good", Command="auto")
    home.press("Stow")
    home.shows(Mode="stow", Command="stow", Stowed="on")
    home.press("Track")
    home.shows(Mode="tracking", Command="auto")
    for option in ("snow", "maintenance", "auto", "hold"):
        home.choose(option)
        home.shows(Command=option)
    home.press("Track")
    home.shows(Mode="tracking")
    home.press("Hold")
    home.shows(Mode="hold")
    home.press("Acknowledge alarms")
    home.shows(Last_reply="acknowledge: ")
    home.press("Track")
    home.shows(Mode="tracking")


def main() -> None:
    """Install, start, look, command, and kill the service."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("python", metavar="PYTHON", help="interpreter for Home Assistant")
    parser.add_argument(
        "version", metavar="VERSION", nargs="?", default=VERSION, help=f"version of Home Assistant [{VERSION}]"
    )
    parser.add_argument(
        "--with", metavar="REQUIREMENT", dest="others", action="append", default=[], help="install this too"
    )
    parser.add_argument("--keep-open", action="store_true", help="wait at the end, so that the pages can be looked at")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
        folder = Path(place)
        install(folder, given.python, given.version, given.others)
        broker = Broker(folder).start()
        stack.callback(broker.kill)
        home = HomeAssistant(folder, broker.port)
        stack.callback(home.process.wait)
        stack.callback(home.process.terminate)
        for dated in (False, True):
            service = serve(folder, broker.port, dated=dated)
            stack.callback(service.kill)
            print(f"Home Assistant {given.version}, dated_commands = {str(dated).lower()}:")
            look(home)
            command(home)
            service.send_signal(signal.SIGKILL)
            home.shows(Mode="unavailable", Command="unavailable", Stop="unavailable")
            print("  every command was seen to work; a killed service is unavailable")
        complaints = [
            line for line in home.log.read_text().splitlines() if re.search("mqtt|heliocube", line, re.IGNORECASE)
        ]
        print("\n".join(complaints) or "Home Assistant has logged nothing about MQTT")
        if given.keep_open:
            input(f"{home.url}, user a, password {'a' * 12}; Enter ends it ")


if __name__ == "__main__":
    main()
