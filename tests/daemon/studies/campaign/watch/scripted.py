"""A scripted plant for the watch, and the broken promises that the watch finds there."""

import contextlib
from types import SimpleNamespace

from daemon.base.records import Mode
from daemon.config.settings import Settings
from daemon.tracker.wishes import Wishes
from solar.frames import Angles


class Scripted:
    """A plant whose truth, telemetry and service are what a test says."""

    def __init__(self, watch):
        self.now_s = 1000.0
        self.clock = SimpleNamespace(monotonic=lambda: self.now_s, utc=lambda: self.now_s, step_s=0.0)
        self.at = {"a": 0.0, "b": 60.0}
        self.count_off = 0.0
        self.destination = {"a": 100.0, "b": 100.0}
        self.plugged = True
        self.is_served = True
        self.wind_m_s = 3.0
        self.motion = SimpleNamespace(connected=True, homing=False, target=None, doubt=None, unexplained_motion=None)
        self.motion.last_move_started_s, self.motion.last_move = 0.0, None
        self.records = []
        self.close_looks = 0
        self.control = SimpleNamespace(mode=Mode.TRACKING, why="", wishes=Wishes())
        self.control.state = SimpleNamespace(scan_age_s=1.0)
        self.sun_deg = 30.0
        self.is_silent = self.is_gone = self.has_slew_drives = False
        self.lowered = ""
        self.per_deg = 5.0
        self.text_prefix = ""
        self.settings = Settings.model_validate({})
        self.service = SimpleNamespace(sun_elevation_deg=lambda utc_s: self.sun_deg)
        self.unit = self
        self.watch = watch
        watch.attach(self)
        watch.note_service_start()
        self.wait(20)

    def truth(self):
        return Angles(self.at["a"], self.at["b"])

    axes = truth

    def range_deg(self, axis):
        limits = self.settings.limits
        return (limits.a_min_deg, limits.a_max_deg) if axis == "a" else (limits.b_min_deg, limits.b_max_deg)

    def units_per_deg(self, axis):
        return self.per_deg

    def is_lowered(self, axis):
        return axis == self.lowered

    def position_and_destination(self, axis, now_s):
        self.close_looks += 1
        position = self.at[axis] * (-self.per_deg if self.is_lowered(axis) else self.per_deg)
        return position, self.destination[axis]

    def changes(self, now_s):
        return hash((self.destination["a"], self.destination["b"]))

    def shown_deg(self, axis, now_s):
        return self.at[axis] + (self.count_off if axis == "a" else 0.0)

    def wait(self, duration_s, a=0.0, b=0.0):
        """Let time pass in samples, the axes turning by so many degrees in all."""
        steps = max(round(duration_s / 0.1), 1)
        for _ in range(steps):
            self.now_s += duration_s / steps
            self.at["a"] += a / steps
            self.at["b"] += b / steps
            self.watch.sample()

    def order(self, a, b, *, taken=True):
        """Let the service order a move and the unit take it, or the driver say that it did not."""
        self.motion.target, self.motion.last_move_started_s = (a, b), self.now_s
        with contextlib.suppress(ConnectionError), self.watch.sending((a, b)):
            self.watch.note_packet(b"$\x2c%g" % a, self.now_s)
            self.watch.note_packet(b"$\x30%g" % b, self.now_s)
            self.destination = {
                "a": a * (-self.per_deg if self.is_lowered("a") else self.per_deg),
                "b": b * (-self.per_deg if self.is_lowered("b") else self.per_deg),
            }
            if not taken:
                raise ConnectionError

    def sends_stop(self):
        self.motion.target = None
        self.watch.note_packet(b"$9s\r", self.now_s)


def promises(plant):
    """The broken promises about motion itself."""
    return [found.promise for found in plant.watch.violations if found.promise not in ("unreported", "false-alarm")]
