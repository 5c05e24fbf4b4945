"""What a person sees while the service runs in a terminal: one screen in place, or a line now and then."""

import asyncio
import math
from collections import deque
from collections.abc import Iterator

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from daemon.base.clock import iso_utc
from daemon.base.records import FACES, Event, FaceReading, Mode, ModeChange, Move, Record, Scan
from daemon.motion.motion import Motion
from daemon.service.service import Service
from daemon.tracker.control import Control, ControlState

_REFRESH_S = 0.25
_LINE_EVERY_S = 5.0
_NEWS = 7
_BAR_WIDTH = 30
_FULL_BAR_W_M2 = 1200.0

_STYLES = {
    Mode.TRACKING: "bold green",
    Mode.NIGHT: "bold blue",
    Mode.FALLBACK: "bold yellow",
    Mode.STOW: "bold magenta",
    Mode.FAULT: "bold red",
    Mode.SNOW: "bold cyan",
    Mode.MAINTENANCE: "bold yellow",
}


class LiveView:
    """Shows the service on a console.

    Parameters
    ----------
    service
        What to show.
    console
        Where; a terminal gets a screen that changes in place, anything else plain lines.
    speed
        How many times as fast as the machine's the service's clock runs.
    """

    def __init__(self, service: Service, console: Console, speed: float) -> None:
        self._service = service
        self._console = console
        self._speed = speed
        self._news: deque[tuple[float, str]] = deque(maxlen=_NEWS)
        self._scan: Scan | None = None
        service.bus.subscribe(self._note)

    async def run(self) -> None:
        """Refresh until cancelled."""
        if not self._console.is_terminal:
            while True:
                await asyncio.sleep(_LINE_EVERY_S * self._speed)
                self._console.print(self._line(), highlight=False, soft_wrap=True)
        with Live(self._screen(), console=self._console, auto_refresh=False, transient=False) as live:
            while True:
                await asyncio.sleep(_REFRESH_S * self._speed)
                live.update(self._screen(), refresh=True)

    def _note(self, record: Record) -> None:
        if isinstance(record, Scan):
            self._scan = record
        elif isinstance(record, ModeChange):
            self._news.append((record.time_utc_s, f"{record.before} -> {record.after}: {record.why}"))
        elif isinstance(record, Event):
            self._news.append((record.time_utc_s, f"{record.subject}: {record.text}"))
        elif isinstance(record, Move):
            text = f"moved to {_angles(record.end_a_deg, record.end_b_deg)} in {record.duration_s:.0f} s"
            if record.outcome != "arrived":
                text += f" ({record.outcome})"
            self._news.append((record.time_utc_s, f"{text}: {record.why}"))

    def _title(self) -> str:
        site = self._service.settings.site
        pace = f", {self._speed:g} x real time" if self._speed != 1 else ""
        simulated = "SIMULATED " if self._service.rig.simulated else ""
        return f"heliocube {simulated}{self._service.role} at {site.name}{pace}"

    def _line(self) -> str:
        parts = [iso_utc(self._service.clock.utc())[:19] + "Z"]
        if self._service.rig.simulated:
            parts.append("SIMULATED")
        if self._scan is not None:
            parts.append(" ".join(f"{n[0].upper()} {_number(f.irradiance_w_m2, '.1f')}" for n, f in _faces(self._scan)))
        control, motion = self._service.control, self._service.motion
        if control is not None and motion is not None:
            state = control.state
            parts += [_pose(motion), f"{state.mode}: {state.why}"]
            parts += [f"ALARM {alarm.name}" for alarm in self._service.alarms.active]
        elif self._service.acquisition is not None and self._service.acquisition.outage.is_down:
            parts.append(self._service.acquisition.outage.reason)
        return " | ".join(parts)

    def _screen(self) -> RenderableType:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim", no_wrap=True)
        grid.add_column()
        utc_s = self._service.clock.utc()
        elevation = self._service.sun_elevation_deg(utc_s)
        grid.add_row("time", f"{iso_utc(utc_s)[:10]} {iso_utc(utc_s)[11:19]} UTC, sun at {elevation:.1f} deg")
        if self._service.rig.sky_text is not None:
            grid.add_row("sky", self._service.rig.sky_text())
        if self._scan is not None:
            for name, face in _faces(self._scan):
                quality = "" if face.quality == "ok" else f"  {face.quality}"
                grid.add_row(name, Text(f"{_bar(face.irradiance_w_m2)} {quality}"))
        control, motion = self._service.control, self._service.motion
        if control is not None and motion is not None:
            self._add_tracker(grid, control, motion)
        acquisition = self._service.acquisition
        if acquisition is not None and acquisition.outage.is_down:
            grid.add_row("cube", Text(acquisition.outage.reason, style="bold red"))
        if self._service.receiver is not None:
            counts = self._service.receiver.statistics
            grid.add_row("bridge", f"{counts.accepted} scans accepted, {counts.lost} lost, {counts.refused} refused")
        news = [Text(f"{iso_utc(when)[11:19]}  {text}", style="dim") for when, text in self._news]
        return Panel(Group(grid, Text(), *news), title=self._title(), subtitle="Ctrl-C ends", expand=True)

    def _add_tracker(self, grid: Table, control: Control, motion: Motion) -> None:
        state: ControlState = control.state
        grid.add_row("mode", Text(f"{state.mode}", style=_STYLES.get(state.mode, "bold")) + Text(f"  {state.why}"))
        for alarm in self._service.alarms.active:
            grid.add_row("alarm", Text(alarm.text, style="bold red"))
        if state.decision is not None and not math.isnan(state.next_decision_s):
            target = state.decision.target
            grid.add_row(
                "target",
                f"{_angles(target.a_deg, target.b_deg)} by {state.decision.law}; next in {state.next_decision_s:.0f} s",
            )
        grid.add_row("tracker", _pose(motion))


def _faces(scan: Scan) -> Iterator[tuple[str, FaceReading]]:
    return zip(FACES, scan.faces, strict=True)


def _bar(irradiance_w_m2: float) -> str:
    share = min(max(irradiance_w_m2 / _FULL_BAR_W_M2, 0.0), 1.0) if math.isfinite(irradiance_w_m2) else 0.0
    return f"{_number(irradiance_w_m2, '6.1f')} W/m2 {'█' * round(share * _BAR_WIDTH)}"


def _number(value: float, form: str) -> str:
    # Rounding first and adding 0.0 keeps "-0" off the screen.
    return format(round(value, 1) + 0.0, form) if math.isfinite(value) else "-"


def _angles(a_deg: float, b_deg: float) -> str:
    return f"A {_number(a_deg, '.1f')}, B {_number(b_deg, '.1f')} deg"


def _pose(motion: Motion) -> str:
    if motion.pose is None:
        return "no telemetry yet"
    where = _angles(motion.pose.a_deg, motion.pose.b_deg)
    if motion.homing:
        return f"{where}, homing"
    if motion.target is not None:
        return f"{where}, moving to {_angles(motion.target.a_deg, motion.target.b_deg)}"
    return where
