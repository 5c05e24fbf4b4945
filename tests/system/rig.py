"""A service on a bench: its rhythm, what it should do, and the phases in which a plug is pulled."""

import time

from solar.frames import Limits, angles_within
from solar.laws.paper import mu_prime
from tests.system.processes import wait_until

WITHIN_DEG = 1.5
ROLES = {"positioner": "the positioner", "voltmeter": "the cube", "multiplexer": "the cube"}
# High sun: the tracker begins near its target, and half shade on two faces turns the target by a few degrees. A dark
# face would not: the law leaves it out.
HIGH_SUN = ("--weather", "clear", "--site", "10,0", "--start", "2022-09-21T11:50Z")
SHADED = ("east", "west")


class Rig:
    """A bench with a service on it."""

    def __init__(self, bench, service):
        self.bench = bench
        self.service = service
        self._turn = 0

    def settle(self):
        wait_until(
            lambda: points_as_the_law_says(self.bench),
            lambda: (
                f"the tracker where the law says, but {distance_from_law(self.bench):.2f} deg off; "
                + self.service.log()
            ),
        )

    def new_sky(self):
        """Change the light so much that the law gives another target."""
        before = law_says(self.bench)
        self.bench.ask("shade", SHADED[self._turn % 2], 1)
        self._turn += 1
        self.bench.ask("shade", SHADED[self._turn % 2], 0.5)
        self.bench.ask("shade", "zenith", 0.7)
        after = law_says(self.bench)
        assert max(abs(old - new) for old, new in zip(before, after, strict=True)) > 3 * WITHIN_DEG

    def survive(self, device, seconds, phase):
        """Pull a plug for a while: the outage is told once, and the tracker tracks again soon.

        Return the share of a processor that the service took without it, and how soon it tracked again [s].
        """
        role = ROLES[device]
        down, back = self.lines(f"{role} is down"), self.lines(f"{role} is back")
        self.bench.ask("unplug", device)
        load = self.load(seconds)
        back_s = self.comes_back(device, phase)
        assert self.lines(f"{role} is down") == down + 1, self.service.log()
        assert self.lines(f"{role} is back") == back + 1, self.service.log()
        return load, back_s

    def comes_back(self, device, phase="at the start"):
        """Plug a device in again, wait until the tracker tracks, and return how long that took [s]."""
        role = ROLES[device]
        back = self.lines(f"{role} is back")
        start_s = time.monotonic()
        self.bench.ask("replug", device)
        self.tidy(device)
        wait_until(
            lambda: self.lines(f"{role} is back") > back and self.last_mode() == "tracking",
            lambda: f"tracking again after {device} {phase}: {self.service.log()}",
        )
        return time.monotonic() - start_s

    def tidy(self, device):
        if device == "positioner":
            self.bench.ask("repair", "deaf")
        else:
            self.bench.ask("delay", device, 0)

    def load(self, seconds):
        """Return the share of one processor that the service uses for a while."""
        start_s, used_s = time.monotonic(), self.service.cpu_s()
        time.sleep(seconds)
        return (self.service.cpu_s() - used_s) / (time.monotonic() - start_s)

    def lines(self, text):
        return self.service.log().count(text)

    def outages(self, sentence):
        return sum(" is down: " in line and sentence in line for line in self.service.log().splitlines())

    def last_mode(self):
        changes = [line.split(" -> ")[1].split(":")[0] for line in self.service.log().splitlines() if " -> " in line]
        return changes[-1] if changes else "starting"


def idle(rig, _device):
    rig.settle()


def mid_exchange(rig, device):
    """Let a question be open when the plug is pulled."""
    if device == "positioner":
        rig.bench.ask("inject", "deaf")
        rig.new_sky()
        asked = rig.lines("moving ")
        wait_until(lambda: rig.lines("moving ") > asked, rig.service.log)
    else:
        rig.bench.ask("delay", device, 0.3)
        time.sleep(1.0)


def mid_move(rig, _device):
    rig.new_sky()
    wait_until(lambda: moves(rig.bench), rig.service.log)


PHASES = (idle, mid_exchange, mid_move)

BRISK = """
[api]
enabled = false
[cube]
scan_every_s = 0.5
reading_deadline_s = 1.5
dark_correction = false
[instruments.multiplexer]
settle_s = 0.02
[instruments.voltmeter]
nplc = 0.1
[windows]
mean_s = 2.0
decide_every_s = 4.0
[motion]
minimum_interval_s = 0.0
[safety]
scan_stale_s = 10.0
[bridge]
listen = "127.0.0.1:0"
send_to = [{send_to}]
insecure = true
[simulation]
motor_speed_mm_s = 6.4
sensor_noise_mv = 0.005
[instruments.positioner]
telemetry_stale_s = 60.0
{positioner}
"""
"""The rig at a brisk rhythm: a scan every half second, a decision every four seconds, motors twice as fast.

A busy machine may hold up a unit's screens for seconds. That is no outage here: outages come from pulled plugs and
restarts. Faster motors would come near to what counts as a jump if the machine shows the screens half a second late.
"""


def brisk(folder, send_to="", positioner=""):
    """Write the configuration that a brisk bench starts from, with more of its positioner, and return its path."""
    file = folder / "brisk.toml"
    file.write_text(BRISK.format(send_to=f'"{send_to}"' if send_to else "", positioner=positioner))
    return file


def law_says(bench):
    """Return the angles A and B that the paper's law gives for what truly falls on the faces now."""
    direction = mu_prime(list(bench.state()["faces"].values()))
    a_deg, b_deg = angles_within(direction, Limits())
    return float(a_deg), float(b_deg)


def distance_from_law(bench):
    """Return by how much the tracker's true angles differ from the law's; the worse of the two [deg]."""
    wanted, pose = law_says(bench), bench.state()["pose"]
    return max(abs(pose["a_deg"] - wanted[0]), abs(pose["b_deg"] - wanted[1]))


def points_as_the_law_says(bench):
    return distance_from_law(bench) <= WITHIN_DEG and not moves(bench)


def moves(bench):
    """Whether the axes are under way."""
    first = bench.state()["pose"]
    time.sleep(0.3)
    return bench.state()["pose"] != first
