"""The campaign on real processes, in real time: ``python -m tests.campaign.real --minutes 5 [--firmware DIR]``.

Faults of the unit, deaths of the service and commands from the shell and over HTTP are drawn from a seed, one to three
at nearly the same time. The true pose is read all the while, and the promises about a stop, about motion without an
order and about "done" are checked against it. Ends with 1 if any was broken.
"""

import argparse
import contextlib
import sys
import tempfile
import threading
import time
from pathlib import Path
from random import Random

from tests.campaign.peers import NotThereError, unit_and_tracker
from tests.support import PATIENCE_S

LOOK_EVERY_S = 0.03
STATE_EVERY_S = 0.2
TURNS_DEG = 0.02
STANDSTILL_S = 0.7
UNEXPLAINED_S = 2.0
RUN_OUT_S = 3.0
# The state is polled over HTTP and the truth over a socket: each look may be this late.
LATE_S = 0.4
CONNECTS_WITHIN_S = 25.0
BY_ITSELF = ("own_tracking", "re_reference", "stranger_a", "stranger_b", "stranger_homes", "buttons")
COMMANDS = ("stop", "stop", "stop", "stow", "hold", "goto", "goto", "goto", "auto", "home", "clear")


class Looker(threading.Thread):
    """Reads the true pose and the service's state, and judges."""

    def __init__(self, unit, tracker):
        super().__init__(daemon=True)
        self._unit, self._tracker = unit, tracker
        self._over = threading.Event()
        self.broken = []
        self.moving = False
        self.stop_s = None
        self.free_s = time.monotonic() + CONNECTS_WITHIN_S
        self.heading = "starting"
        self._ordered_s = time.monotonic()
        self._unexplained_s = None

    def frees(self, for_s):
        """Excuse motion for so long: the service cannot know of its cause, or cannot prevent it."""
        self.free_s = max(self.free_s, time.monotonic() + for_s)

    def fails(self, promise, text):
        now_s = time.monotonic()
        if not any(promise == before and now_s - at_s < 30 for before, at_s, _ in self.broken):
            self.broken.append((promise, now_s, text))
            print(f"{promise}: {text}", flush=True)

    def close(self):
        self._over.set()
        self.join()

    def run(self):
        at, at_s, state_s = self._unit.truth(), time.monotonic(), 0.0
        while not self._over.wait(LOOK_EVERY_S):
            now_s = time.monotonic()
            if now_s - state_s > STATE_EVERY_S:
                state_s = now_s
                self._look_at_state(now_s)
            before, at = at, self._unit.truth()
            gone_s, at_s = time.monotonic() - at_s, time.monotonic()
            turned_deg = max(abs(before[0] - at[0]), abs(before[1] - at[1]))
            self.moving = turned_deg > TURNS_DEG * gone_s / LOOK_EVERY_S * 0.3
            self._judge(at, at_s)

    def _look_at_state(self, now_s):
        try:
            tracker = self._tracker.state()["tracker"]
        except (OSError, ValueError, KeyError):
            self.heading = "no service"
            self._ordered_s = now_s
            return
        if tracker.get("homing"):
            self.heading = "homing"
        else:
            self.heading = "target" if tracker.get("target") else ""
        if self.heading:
            self._ordered_s = now_s

    def _judge(self, at, now_s):
        if not self.moving or now_s < self.free_s:
            self._unexplained_s = None
            return
        if self.stop_s is not None and now_s > self.stop_s + STANDSTILL_S + LATE_S:
            self.fails("moves-under-stop", f"the axes move {now_s - self.stop_s:.1f} s after a stop, at {at}")
        if now_s - self._ordered_s < RUN_OUT_S:
            self._unexplained_s = None
            return
        self._unexplained_s = self._unexplained_s or now_s
        if now_s - self._unexplained_s > UNEXPLAINED_S + LATE_S:
            self.fails("unexplained-motion", f"the axes move for {now_s - self._unexplained_s:.1f} s, at {at}")


class Attack:
    """One run of some minutes."""

    def __init__(self, unit, tracker, random):
        self._unit, self._tracker, self._random = unit, tracker, random
        self._looker = Looker(unit, tracker)
        self._threads = []

    def run(self, minutes):
        """Attack for some minutes and return the broken promises."""
        self._looker.start()
        end_s = time.monotonic() + 60 * minutes
        try:
            while time.monotonic() < end_s:
                self._episode()
            self._look_at_service()
        finally:
            for thread in self._threads:
                thread.join(PATIENCE_S)
            self._looker.close()
        return self._looker.broken

    def _episode(self):
        random = self._random
        if random.random() < 0.8:
            for name in ("auto", "clear"):
                self._command(name)
        if random.random() < 0.8:
            self._command("goto")
            time.sleep(random.uniform(0, 6))
        for _ in range(random.choice((1, 1, 2, 3))):
            time.sleep(random.choice((0.0, random.uniform(0, 0.3), random.uniform(0, 3))))
            if random.random() < 0.5:
                self._begin(self._disturb, random.choice((*self._unit.disturbances, "kill", "end")))
            else:
                self._begin(self._command, random.choice(COMMANDS))
        time.sleep(random.uniform(3, 12))
        self._look_at_service()
        self._threads = [thread for thread in self._threads if thread.is_alive()]

    def _begin(self, call, name):
        thread = threading.Thread(target=call, args=(name,), daemon=True)
        thread.start()
        self._threads.append(thread)

    def _disturb(self, name):
        lasts_s, looker = self._random.uniform(0.3, 8), self._looker
        print(f"  {name} for {lasts_s:.1f} s", flush=True)
        looker.frees(lasts_s + CONNECTS_WITHIN_S if name not in BY_ITSELF else UNEXPLAINED_S + LATE_S)
        if name in ("kill", "end"):
            self._tracker.kill() if name == "kill" else self._tracker.end()
            time.sleep(lasts_s)
            self._tracker.start()
            looker.frees(CONNECTS_WITHIN_S)
            return
        self._unit.disturb(name, on=True)
        time.sleep(lasts_s)
        self._unit.disturb(name, on=False)
        if name == "buttons":
            looker.frees(RUN_OUT_S)

    def _command(self, name):
        random, looker = self._random, self._looker
        degrees = {"a_deg": random.uniform(-50, 50), "b_deg": random.uniform(15, 90)} if name == "goto" else {}
        way = random.choice(("HTTP", "shell"))
        print(f"  {name} {' '.join(f'{value:.1f}' for value in degrees.values())} by {way}", flush=True)
        if name == "stop":
            looker.stop_s = time.monotonic()
        elif name == "auto":
            looker.stop_s = None
        if way == "shell":
            with self._tracker.shell(name, *(f"{value:.2f}" for value in degrees.values())) as process:
                said = process.communicate(timeout=PATIENCE_S)[0]
            self._look_at_words(name, said)
            return
        with contextlib.suppress(OSError):
            status, said = self._tracker.post(name, **degrees)
            if status >= 500:
                looker.fails("defect", f"{name} is answered with {status}: {said}")
            if name == "stop" and status == 200 and said["done"]:
                time.sleep(2 * LOOK_EVERY_S)
                if looker.moving and looker.stop_s is not None and time.monotonic() > looker.free_s:
                    looker.fails("false-done", f"stop is said to be done and an axis moves: {said['text']}")

    def _look_at_words(self, name, said):
        if "Traceback" in said or len(said.strip().splitlines()) > 6:
            self._looker.fails("sentence", f"{name} prints {said!r}")

    def _look_at_service(self):
        if "Traceback" in self._tracker.log():
            self._looker.fails("defect", "the service's log has a traceback")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--minutes", type=float, default=5.0, help="how long faults and commands go on (default: %(default)g)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the schedule (default: %(default)s)")
    parser.add_argument("--firmware", type=Path, help="directory of the firmware's server, in place of the bench")
    parser.add_argument("--build", default="micro", help="which build of the firmware")
    parser.add_argument("--log", type=Path, help="keep the service's log here")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            with unit_and_tracker(Path(folder), chosen.firmware, chosen.build) as both:
                broken = Attack(*both, Random(chosen.seed)).run(chosen.minutes)
        except NotThereError as error:
            sys.exit(str(error))
        finally:
            if chosen.log:
                chosen.log.write_text((Path(folder) / "service.log").read_text())
    print(f"{chosen.minutes:g} min of attack, seed {chosen.seed}: {len(broken)} promises broken")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
