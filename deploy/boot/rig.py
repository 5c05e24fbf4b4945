"""The rig inside the machine: the bench as a unit, a broker with a wind sensor, and both roles configured for them."""

import json
from datetime import UTC, datetime, timedelta
from typing import Any

from boot.host import CheckFailed, wait
from boot.machine import Machine

PROGRAM = "/opt/heliocube/current/bin/heliocube"
UNITS = ("heliocube-cube.service", "heliocube-tracker.service")
CUBE, TRACKER = UNITS
BENCH = "/run/bench"
WIND_TOPIC = "weather/roof"
CALM_M_S, STORM_M_S = 3.0, 25.0

BASE_CONFIG = f"""
[site]
latitude_deg = 30.0
longitude_deg = 0.0
[cube]
scan_every_s = 1.0
reading_deadline_s = 0.8
dark_correction = false
[instruments.multiplexer]
settle_s = 0.02
[instruments.voltmeter]
nplc = 0.1
[windows]
mean_s = 6.0
decide_every_s = 6.0
[motion]
minimum_interval_s = 0.0
deadband_deg = 3.0
[safety]
scan_stale_s = 5.0
stow_at_least_s = 4.0
[bridge]
key_file = "/etc/heliocube/bridge.key"
[store]
directory = "/var/lib/heliocube/tracker"
batch_s = 1.0
[api]
listen = "127.0.0.1:20572"
token_file = "/etc/heliocube/api.token"
[mqtt]
enabled = true
[mqtt.wind]
topic = "{WIND_TOPIC}"
[simulation]
motor_speed_mm_s = 12.8
sensor_noise_mv = 0.005
"""
"""A scan a second and a decision every six; motors four times as fast as the unit's.

The sun takes ten minutes to need a move: a move between a look at the axes and the end of a process would pass for one
that came after that end.
"""


def _bench_unit() -> str:
    """Return the bench's unit; its sun is yesterday's at noon, so that the nightly report has a day to write about."""
    yesterday = (datetime.now(UTC) - timedelta(days=1)).date()
    return f"""
[Unit]
Description=the rig that is not there
[Service]
User=heliocube
Group=heliocube
RuntimeDirectory={BENCH.removeprefix("/run/")}
ExecStart={PROGRAM} bench --dir {BENCH} --weather clear --start {yesterday}T11:50Z --config /etc/heliocube/basis.toml
"""


class BootRig:
    """Bench, broker and both services on a machine.

    Parameters
    ----------
    machine
        On which heliocube is installed and runs.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def start_bench(self) -> str:
        """Start the bench and write what both services are configured with."""
        self._machine.write("/etc/heliocube/basis.toml", BASE_CONFIG, 0o644)
        self._machine.write("/etc/systemd/system/bench.service", _bench_unit())
        self._machine.systemctl("daemon-reload")
        self._machine.systemctl("start", "bench.service")
        written = f"{BENCH}/heliocube.toml"
        text = wait(
            lambda: self._machine.run_unchecked("cat", written).stdout,
            lambda: f"the bench is ready; {self._machine.journal('bench.service', 8)}",
        )
        self._machine.write("/etc/heliocube/tracker.toml", text, 0o640)
        cube = text.replace("127.0.0.1:20572", "127.0.0.1:20573").replace("/heliocube/tracker", "/heliocube/cube")
        self._machine.write("/etc/heliocube/cube.toml", cube, 0o640)
        self._machine.run("systemd-tmpfiles", "--create", "heliocube.conf")
        return f"ready; both roles are configured for {written}"

    def read_bench_state(self) -> dict[str, Any]:
        """Return the truth of the bench."""
        found: dict[str, Any] = json.loads(self._machine.run(PROGRAM, "bench-ctl", BENCH, "state"))
        return found

    def pose(self) -> tuple[float, float]:
        """Return where the axes truly stand, A and B [deg]."""
        pose = self.read_bench_state()["pose"]
        return pose["a_deg"], pose["b_deg"]

    def wait_until_at_rest(self) -> tuple[float, float]:
        """Wait until the axes stand still and return where; the end of a process does not end its move."""
        seen = [self.pose()]

        def stands() -> bool:
            seen.append(self.pose())
            return seen[-1] == seen[-2]

        wait(stands, lambda: f"the axes at rest; they stand at {seen[-1]}", pause_s=0.5)
        return seen[-1]

    def publish_wind(self, speed_m_s: float) -> None:
        """Let the sensor say once how strong the wind is."""
        self._machine.run("mosquitto_pub", "-h", "127.0.0.1", "-t", WIND_TOPIC, "-m", f"{speed_m_s:g}")

    def status(self) -> dict[str, Any]:
        """Return the tracker's state; empty while it cannot be reached."""
        done = self._machine.run_unchecked(PROGRAM, "status", "--json", "--config", "/etc/heliocube/tracker.toml")
        return json.loads(done.stdout) if done.returncode == 0 else {}

    def mode(self) -> tuple[str, str]:
        """Return the tracker's mode and its reason; empty while it cannot be reached."""
        mode = self.status().get("mode") or {}
        return str(mode.get("name", "")), str(mode.get("why", ""))

    def wait_mode(self, wanted: str) -> str:
        """Wait for a mode and return its reason."""

        def look() -> str:
            mode, reason = self.mode()
            return reason or "for no reason" if mode == wanted else ""

        return wait(look, lambda: f"mode {wanted}; it is {self.mode()}")

    def check_not_moved(self, before: tuple[float, float]) -> None:
        """Raise `CheckFailed` if the axes stand elsewhere than they did."""
        now = self.pose()
        if max(abs(old - new) for old, new in zip(before, now, strict=True)) > 0.1:
            raise CheckFailed(f"the axes moved from {before} to {now}")
