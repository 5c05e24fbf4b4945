"""A cube's faces through a day of passing clouds, and the watch that judges them."""

import numpy as np

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kept import AlarmFile
from daemon.base.clock_watch import ClockWatch
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.cube.face_watch import FaceWatch
from solar.ephemeris import extraterrestrial_dni, sun_direction
from solar.skies.sky import sky


class SettableClock:
    """A clock that a test sets."""

    def __init__(self, utc_s, off_s=0.0):
        self.utc_s = utc_s
        self.off_s = off_s
        self.slept_s = 0.0

    def monotonic(self):
        return self.utc_s - self.slept_s

    def asleep_s(self):
        return self.slept_s

    def utc(self):
        return self.utc_s + self.off_s


class WatchedDay:
    """Faces of a day with a cloud every 20 minutes, given to a watch scan by scan."""

    def __init__(self, start_utc_s, off_s=0.0, directory=None, **faces):
        self.clock = SettableClock(start_utc_s, off_s)
        self.synchronised = None
        settings = Settings()
        self.site = settings.site.place()
        self.alarms = Alarms(self.clock, lambda _record: None, file=AlarmFile(StateFolder(directory)))
        clock_watch = ClockWatch(self.clock, synchronised=lambda: self.synchronised)
        cube = settings.cube.model_copy(update=faces)
        self.watch = FaceWatch(settings.site, cube, self.clock, self.alarms, clock_watch)
        self.random = np.random.default_rng(1)
        self.order = [0, 1, 2, 3]
        self.share = [1.0] * 4
        self.in_cloud_w_m2 = 150.0

    def minutes(self, count, frozen=None, at_w_m2=0.0, every_s=15.0, late_s=0.0, exactly=False):
        """Let scans come, up to `late_s` late; returns after how many minutes each face was found, or None."""
        found = [None] * 4
        numbers = np.arange(1, int(60.0 * count / every_s) + 1)
        utc_s = self.clock.utc_s + every_s * numbers + late_s * np.random.default_rng(2).random(numbers.size)
        sun = sun_direction(utc_s, *self.site)
        beam = np.where(utc_s % 1200 < 300, self.in_cloud_w_m2, 750.0) * (sun[:, 2] > 0)
        light = sky("perez1990", sun, beam, np.where(sun[:, 2] > -0.05, 140.0, 0.0), extraterrestrial_dni(utc_s))
        normals = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, -1, 0], [0.0, 0, 1]])
        faces = np.stack([light.irradiance_on(normal[None, :]) for normal in normals], axis=-1)
        faces = faces[:, self.order] * self.share
        if frozen is not None:
            faces[:, frozen] = at_w_m2
        faces += self.random.normal(0.0, 0.3, faces.shape)
        if exactly:
            faces[:, frozen] = at_w_m2
        for number, (at_s, row) in enumerate(zip(utc_s.tolist(), faces.tolist(), strict=True)):
            self.clock.utc_s = at_s
            self.watch.note(row, [value / 10 for value in row])
            for face in range(4):
                if found[face] is None and self.watch.implausible(face):
                    found[face] = number * every_s / 60.0
        return found

    def sleep(self, lasts_s):
        self.clock.utc_s += lasts_s
        self.clock.slept_s += lasts_s

    def implausible_faces(self):
        return [face for face in range(4) if self.watch.implausible(face)]
