"""Points about starting and coming back: after a boot, a kill, a freeze and a storm."""

import threading
import time
from functools import partial

from boot.host import PATIENCE_S, CheckFailed, wait
from boot.machine import Machine
from boot.rig import CALM_M_S, CUBE, STORM_M_S, TRACKER, UNITS, BootRig

STOW_TOLERANCE_DEG = 0.2
KILLS = 10


class Restarts:
    """What the units do when they start, and after whatever ends them.

    Parameters
    ----------
    machine, rig
        Booted and started.
    """

    def __init__(self, machine: Machine, rig: BootRig) -> None:
        self._machine = machine
        self._rig = rig
        self._old: dict[str, int] = {}
        self._killing: threading.Thread | None = None
        self._killed_in_s = 0.0
        self._frozen_pose = (0.0, 0.0)
        self._frozen_at_s = 0.0

    def check_start(self) -> str:
        """See that both units say by notify that they are ready."""
        self._machine.systemctl("enable", "--now", "--no-block", *UNITS)
        took = {unit: self._machine.wait_active(unit) for unit in UNITS}
        kinds = {self._machine.show(unit, "Type")["Type"] for unit in UNITS}
        if kinds != {"notify"}:
            raise CheckFailed(f"the units are of type {', '.join(sorted(kinds))}")
        return f"active by notify after {max(took.values()):.1f} s"

    def check_wait_for_wind(self) -> str:
        """See that nothing is tracked before the wind has been heard."""
        return self.check_hold_until_wind(self._rig.pose())

    def check_hold_until_wind(self, before: tuple[float, float]) -> str:
        """Wait until only the wind is missing, see that nothing has moved, let it be heard, and wait for tracking."""
        wait(self._waits_for_wind, lambda: f"waiting for the wind; {self._rig.mode()}")
        _, reason = self._rig.mode()
        self._rig.check_not_moved(before)
        self._rig.publish_wind(CALM_M_S)
        self._rig.wait_mode("tracking")
        return f'held with "{reason}", tracks since the wind was heard'

    def check_hold_until_released(self, before: tuple[float, float]) -> str:
        """See that another release holds, once it has heard the wind, and that it tracks when a person says so.

        Where both releases are the same program it tracks by itself, as after any restart.
        """
        wait(self._holds_or_waits, lambda: f"a hold, or waiting for the wind; {self._rig.mode()}")
        self._rig.check_not_moved(before)
        self._rig.publish_wind(CALM_M_S)
        mode = wait(self._mode_at_work, lambda: f"a mode of work; it is {self._rig.mode()}")
        if mode == "tracking":
            return "held until the wind was heard, and tracks again: both are the same program"
        _, reason = self._rig.mode()
        self._rig.check_not_moved(before)
        self._machine.run("heliocube", "auto", "--config", "/etc/heliocube/tracker.toml")
        self._rig.wait_mode("tracking")
        return f'held with "{reason}", tracks since a person said auto'

    def _holds_or_waits(self) -> bool:
        # An earlier order outranks the wait for the wind. Mode and reason are of one look: another may see another one.
        mode, reason = self._rig.mode()
        return mode == "hold" or self._waits(mode, reason)

    def _mode_at_work(self) -> str:
        mode, _ = self._rig.mode()
        return mode if mode in {"hold", "tracking"} else ""

    def _waits_for_wind(self) -> bool:
        return self._waits(*self._rig.mode())

    def _waits(self, mode: str, reason: str) -> bool:
        if mode not in {"", "starting"}:
            raise CheckFailed(f"before the wind was heard the mode is {mode}: {reason}")
        return "wind" in reason and self._has_readings()

    def _has_readings(self) -> bool:
        return (self._rig.status().get("scan") or {}).get("stale") is False

    def check_status_text(self) -> str:
        """See the words of the service in `systemctl status`."""
        words = {CUBE: "", TRACKER: "tracking"}
        for unit, word in words.items():
            text = wait(partial(self._status_text, unit, word), f"a word of {unit}")
            if f'Status: "{text[:20]}' not in self._machine.run_unchecked("systemctl", "status", unit).stdout:
                raise CheckFailed(f"{unit} says {text!r}, and systemctl status does not")
            words[unit] = text
        return "; ".join(f'"{text}"' for text in words.values())

    def _status_text(self, unit: str, word: str) -> str:
        text = self._machine.show(unit, "StatusText")["StatusText"]
        return text if text.startswith(word) else ""

    def check_kill(self) -> str:
        """See each unit back after kill -9; the tracker holds until it has readings and has heard the wind."""
        before = self._rig.wait_until_at_rest()
        took = self._kill_and_wait(*UNITS)
        held = self.check_hold_until_wind(before)
        return ", ".join(f"{unit.split('.')[0]} back after {s:.1f} s" for unit, s in took.items()) + f", {held}"

    def _kill_and_wait(self, *units: str) -> dict[str, float]:
        """Kill the processes of units at once and return how long it took until the next ones were ready [s]."""
        old = {unit: self._restarts(unit) for unit in units}
        began_s = time.monotonic()
        self._machine.systemctl("kill", "--kill-whom=main", "--signal=KILL", *units)
        for unit in units:
            self._wait_restarted(unit, old[unit])
        return {unit: self._active_since_s(unit) - began_s for unit in units}

    def _wait_restarted(self, unit: str, old: int) -> None:
        wait(
            lambda: self._restarts(unit) > old and self._machine.is_active(unit),
            lambda: f"{unit} back; {self._machine.journal(unit, 8)}",
        )

    def _restarts(self, unit: str) -> int:
        return int(self._machine.show(unit, "NRestarts")["NRestarts"])

    def check_stow_after_kill(self) -> str:
        """See that a stow outlives the process: the next one stows too, stands still, and lets go only in calm."""
        self._rig.publish_wind(STORM_M_S)
        self._rig.wait_mode("stow")
        wait(self._is_stowed, lambda: f"the stow position; it stands at {self._rig.pose()}")
        before = self._rig.wait_until_at_rest()
        took_s = self._kill_and_wait(TRACKER)[TRACKER]
        reason = self._rig.wait_mode("stow")
        wait(self._has_readings, lambda: f"good readings; {self._rig.mode()}")
        mode, _ = self._rig.mode()
        if mode != "stow":
            raise CheckFailed(f"with readings again the mode is {mode}")
        self._rig.check_not_moved(before)
        wait(self._tracks_in_calm, lambda: f"mode tracking; it is {self._rig.mode()}")
        # Otherwise the next look whether it rests might come before this move has begun.
        wait(lambda: not self._is_stowed(), lambda: f"the way back; it stands at {self._rig.pose()}")
        return f'back after {took_s:.1f} s, stowed ("{reason}"), released once it was calm'

    def _tracks_in_calm(self) -> bool:
        # One message of calm only begins the time for which it has to be calm; a sensor goes on sending.
        self._rig.publish_wind(CALM_M_S)
        return self._rig.mode()[0] == "tracking"

    def _is_stowed(self) -> bool:
        a_deg, b_deg = self._rig.pose()
        # B goes first; at noon A still has a degree to go after that.
        return max(abs(a_deg), abs(b_deg - 90.0)) < STOW_TOLERANCE_DEG

    def freeze_and_kill(self) -> str:
        """Freeze the tracker and begin to kill the cube, and go on: what systemd does about it is looked at later."""
        self._old = {unit: self._restarts(unit) for unit in UNITS}
        self._frozen_pose = self._rig.wait_until_at_rest()
        self._frozen_at_s = time.monotonic()
        self._machine.systemctl("kill", "--kill-whom=main", "--signal=STOP", TRACKER)
        self._killing = threading.Thread(target=self._kill_often, args=(CUBE,), daemon=True)
        self._killing.start()
        return "the tracker's process is stopped, and the cube's is killed again and again; see below"

    def check_watchdog(self) -> str:
        """See that the watchdog has ended what was frozen, and that it then holds as after a kill."""
        self._wait_restarted(TRACKER, self._old[TRACKER])
        entries = self._machine.journal_entries(f"UNIT={TRACKER}", "_PID=1", "--lines=20")
        said = " / ".join(str(entry["MESSAGE"]) for entry in entries)
        if "Watchdog timeout" not in said:
            raise CheckFailed(f"no watchdog ended it: {said}")
        took_s = self._active_since_s(TRACKER) - self._frozen_at_s
        return f"heliocube-tracker ready again after {took_s:.0f} s, {self.check_hold_until_wind(self._frozen_pose)}"

    def _active_since_s(self, unit: str) -> float:
        """Return when a unit became active, by the clock of `time.monotonic`, which systemd's stamp has too [s]."""
        name = "ActiveEnterTimestampMonotonic"
        return int(self._machine.show(unit, name)[name]) / 1e6

    def check_repeated_kills(self) -> str:
        """See that neither of the units is left in `failed` for good by ten kills in a minute."""
        if self._killing is None:
            raise CheckFailed("nothing was killed")
        self._killing.join(KILLS * PATIENCE_S)
        self._machine.wait_active(CUBE)
        if (count := self._restarts(CUBE) - self._old[CUBE]) < KILLS:
            raise CheckFailed(f"{CUBE} was started again {count} times only; {self._machine.journal(CUBE, 8)}")
        name = "StartLimitIntervalUSec"
        limits = {unit: self._machine.show(unit, name)[name] for unit in UNITS}
        if set(limits.values()) != {"0"}:
            raise CheckFailed(f"systemd gives up after some starts: {limits}")
        return f"heliocube-cube killed {KILLS} times in {self._killed_in_s:.0f} s, active again; no limit for either"

    def _kill_often(self, unit: str) -> None:
        """Kill a unit's process as often as there is a new one."""
        began_s, last = time.monotonic(), "0"
        for _ in range(KILLS):

            def process(last: str = last) -> str:
                pid = self._machine.show(unit, "MainPID")["MainPID"]
                return pid if pid not in {"0", last} else ""

            try:
                last = wait(process, f"a process of {unit}")
            except CheckFailed:
                break
            self._machine.run_unchecked("systemctl", "kill", "--kill-whom=main", "--signal=KILL", unit)
        self._killed_in_s = time.monotonic() - began_s
