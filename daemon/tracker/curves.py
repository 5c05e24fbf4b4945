"""The I-V curve of the module on the tracker, every few seconds; the module is in open circuit in between."""

import asyncio
import base64
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from random import Random

import numpy as np

from daemon.base.clock import Clock
from daemon.base.reconnect import Outage, PeriodicSchedule, Reconnection
from daemon.base.records import CurveQuality, Event, IvCurve, Quality, Record, Scan
from drivers.errors import DeviceError
from drivers.interfaces import ElectronicLoad, SweptCurve
from drivers.settings import LoadSettings
from solar.iv import measured_maximum, sweep_voltages

log = logging.getLogger("heliocube.load")

_LOWEST_SUN_DEG = -3.0
# A smaller change is the sensor's noise at dusk.
_LEAST_CHANGE_W_M2 = 5.0
# An open-circuit voltage below this many times the lowest voltage leaves nothing to sweep.
_LEAST_OPEN_CIRCUIT = 2.0


class IvAcquisition:
    """Sweeps, fits, and hands every curve on. While the sun is well below the horizon it does nothing.

    Parameters
    ----------
    settings
        Rhythm and shape of the curves.
    load
        The instrument, owned from here on.
    clock
        The service's time.
    random
        For the jitter of reconnection.
    publish
        Called with every curve, and with events worth telling.
    sun_elevation_deg
        Returns the sun's elevation at a UTC [s].
    scan_stale_s
        Age from which the cube's last reading counts as unknown.
    time_known
        Tells whether the time of day is believed. If not, curves are measured whatever the sun's position, and are
        marked as of doubtful time.
    """

    def __init__(
        self,
        settings: LoadSettings,
        load: ElectronicLoad,
        clock: Clock,
        random: Random,
        publish: Callable[[Record], None],
        sun_elevation_deg: Callable[[float], float],
        scan_stale_s: float,
        time_known: Callable[[], bool] = lambda: True,
    ) -> None:
        self._settings = settings
        self._load = load
        self._clock = clock
        self._publish = publish
        self._sun_elevation_deg = sun_elevation_deg
        self._scan_stale_s = scan_stale_s
        self._time_known = time_known
        self._zenith_w_m2, self._zenith_s = math.nan, -math.inf
        self.outage = Outage(log, "the load")
        self._reconnection = Reconnection(self.outage, random, clock.monotonic, self._notify, lost=DeviceError)
        self._rhythm = PeriodicSchedule(settings.period_s)
        self._was_open = self._has_failed = False
        self.identity: str | None = None
        self.last: IvCurve | None = None

    @property
    def skipped(self) -> int:
        """How many curves were left out because the one before took too long."""
        return self._rhythm.skipped

    def note(self, record: Record) -> None:
        """Remember what the cube's zenith face reads; a subscriber of the bus."""
        if isinstance(record, Scan):
            good = record.zenith.quality is Quality.OK
            self._zenith_w_m2 = record.zenith.irradiance_w_m2 if good else math.nan
            self._zenith_s = record.time_monotonic_s

    async def run(self) -> None:
        """Measure until cancelled; a lost load is opened anew for as long as it takes."""
        try:
            await self._reconnection.run(self._measure, self._close)
        finally:
            await self._load.close()

    async def _close(self) -> None:
        self.identity = None
        await self._load.close()

    @contextmanager
    def _treat_error_as_lost(self) -> Iterator[None]:
        """Treat an error that the driver does not foresee as a lost load: no tracker ends for want of a measurement."""
        try:
            yield
        except DeviceError:
            raise
        except Exception as error:
            if not self._has_failed:
                self._has_failed = True
                log.exception("the driver of the load has failed")
            raise DeviceError("load", f"its driver has failed ({type(error).__name__}: {error})") from error

    async def _open(self) -> None:
        with self._treat_error_as_lost():
            self.identity = await self._load.open()
        if not self._was_open:
            self._was_open = True
            log.info("the load is open", extra={"fields": {"load": self.identity}})

    async def _measure(self) -> None:
        await self._open()
        self._rhythm.start(self._clock.monotonic())
        while True:
            curve = None
            if not self._time_known() or self._sun_elevation_deg(self._clock.utc()) > _LOWEST_SUN_DEG:
                curve = await self._measure_curve()
            self._reconnection.note_working()
            if curve is not None:
                self.last = curve
                self._publish(curve)
            await asyncio.sleep(self._rhythm.wait_s(self._clock.monotonic()))

    async def _measure_curve(self) -> IvCurve:
        utc_s, start_s, before = self._clock.utc(), self._clock.monotonic(), self._zenith()
        with self._treat_error_as_lost():
            swept = await self._load.sweep(self._plan_voltages, lambda: self._light_change_text(before))
        return self._judge_curve(swept, utc_s, start_s, before)

    def _plan_voltages(self, open_circuit_v: float) -> Sequence[float]:
        least_v = self._settings.minimum_voltage_v
        if not open_circuit_v >= _LEAST_OPEN_CIRCUIT * least_v:
            return ()
        return [float(voltage_v) for voltage_v in sweep_voltages(open_circuit_v, least_v, self._settings.points)]

    def _zenith(self) -> float:
        age_s = self._clock.monotonic() - self._zenith_s
        return self._zenith_w_m2 if age_s <= self._scan_stale_s else math.nan

    def _light_change_text(self, before: float) -> str | None:
        now = self._zenith()
        if abs(now - before) > max(self._settings.abort_change * before, _LEAST_CHANGE_W_M2):
            return f"the zenith irradiance went from {before:z.0f} to {now:z.0f} W/m2"
        return None

    def _judge_curve(self, swept: SweptCurve, utc_s: float, start_s: float, before: float) -> IvCurve:
        voltage_v, current_a = np.array(swept.voltage_v), np.array(swept.current_a)
        found = measured_maximum(np.append(voltage_v, swept.open_circuit_v), np.append(current_a, 0.0))
        quality, why = CurveQuality.OK, ""
        if swept.stopped_why:
            quality, why = CurveQuality.STOPPED, swept.stopped_why
        elif swept.open_circuit_v < _LEAST_OPEN_CIRCUIT * self._settings.minimum_voltage_v:
            quality, why = CurveQuality.DARK, f"the open-circuit voltage is {swept.open_circuit_v:.2f} V"
        elif found.why_not:
            quality, why = CurveQuality.NO_MAXIMUM, found.why_not
        elif not self._time_known():
            quality, why = CurveQuality.CLOCK, "the clock was set, and nothing confirms its time"
        return IvCurve(
            time_utc_s=utc_s,
            time_monotonic_s=start_s,
            duration_s=self._clock.monotonic() - start_s,
            pmpp_w=found.pmpp_w,
            pmpp_sigma_w=found.pmpp_sigma_w,
            vmpp_v=found.vmpp_v,
            impp_a=found.impp_a,
            voc_v=swept.open_circuit_v,
            isc_a=found.isc_a,
            zenith_start_w_m2=before,
            zenith_end_w_m2=self._zenith(),
            points=len(swept.voltage_v),
            quality=quality,
            why=why,
            curve=_encode_curve(voltage_v, current_a) if self._settings.keep_curves else "",
        )

    def _notify(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "load", text))


def _encode_curve(voltage_v: np.ndarray, current_a: np.ndarray) -> str:
    return base64.b64encode(np.concatenate([voltage_v, current_a]).astype("<f4").tobytes()).decode("ascii")
