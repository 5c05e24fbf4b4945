"""One run of test-boot, from the tree to the last point."""

import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from boot.companions import Companions
from boot.emulated import EmulatedMachine
from boot.machine import Machine
from boot.packages import Packages
from boot.records import ROLES, Records
from boot.report import Report
from boot.restarts import Restarts
from boot.rig import BootRig
from boot.sandbox import Sandbox
from boot.tree import PACKAGES, Tree


class BootSession:
    """The points in their order: slow ones wait while others are looked at.

    Parameters
    ----------
    tree
        What is booted.
    report
        Where each point goes.
    """

    def __init__(self, tree: Tree, report: Report) -> None:
        self._tree = tree
        self._packages = Packages(self._tree)
        self._report = report

    def prepare(self, work: Path) -> None:
        """Make what is booted in a new folder and leave it there; nothing is left unless all of it could be made."""
        made = False
        try:
            if self._make(work):
                self._report.run_check("the emulated machine", self._emulated().prepare)
                self._packages.save_prepared()
                made = True
        finally:
            _end_undisturbed()
            self._tree.remove(keep=made)

    def run(self, prepared: Path | None = None) -> None:
        """Do all of it, and leave nothing behind whatever happens; `CheckSkipped` where no container boots."""
        machine = None
        try:
            if prepared is not None and self._packages.has_prepared(prepared):
                self._report.run_check("what was prepared", lambda: self._packages.load_prepared(prepared))
            elif not self._make(None):
                return
            machine = Machine(self._tree.root, self._tree.machine, (self._tree.packages, PACKAGES))
            said = machine.boot()
            self._report.run_check("booting", lambda: said)
            self._look(machine)
        finally:
            _end_undisturbed()
            if machine is not None:
                machine.stop()
            self._tree.remove()

    def _make(self, work: Path | None) -> bool:
        """Make the tree with the package of the commit before installed, and that of this commit beside it."""
        point = self._report.run_check
        return (
            point("the tree", lambda: self._tree.make(work))
            and point("building the packages", self._packages.build)
            and point("installing", self._packages.install)
        )

    def _emulated(self) -> EmulatedMachine:
        return EmulatedMachine(self._tree.cache, self._tree.base)

    def _look(self, machine: Machine) -> None:
        rig, point = BootRig(machine), self._report.run_check
        restarts, records = Restarts(machine, rig), Records(machine)
        if not point("the bench", rig.start_bench):
            return
        if not point("starting both units", restarts.check_start):
            return
        point("the first readings and the wind", restarts.check_wait_for_wind)
        point("systemctl status", restarts.check_status_text)
        point("an upgrade at work", lambda: self._packages.upgrade(machine, rig, records, restarts))
        point("the way back", lambda: self._packages.check_rollback(machine, rig, restarts))
        point("manual and completion", lambda: self._packages.check_manual_pages(machine))
        sandbox = Sandbox(machine, self._emulated())
        companions = Companions(machine)
        before = {role: records.scans(role) for role in ROLES}
        point("kill -9", restarts.check_kill)
        point("a storm across a restart", restarts.check_stow_after_kill)
        point("dashboard and alarms", companions.start)
        point("the dashboard's page", companions.check_dashboard_page)
        point("a freeze and kills", restarts.freeze_and_kill)
        point("systemd-analyze security", sandbox.check_exposure)
        sandbox.prepare()
        point("the sandbox", sandbox.check_access)
        # The foreign points may need another machine to be started, and no restart is to wait for that.
        with ThreadPoolExecutor(max_workers=1) as beside:
            foreign = beside.submit(self._look_foreign, sandbox)
            point("silence reaches people", companions.check_silence_notice)
            point("the nightly report", companions.check_nightly_report)
            point("the watchdog", restarts.check_watchdog)
            point("ten kills in a minute", restarts.check_repeated_kills)
            point("the stores", lambda: records.check_stores(before))
            point("the journal's fields", records.check_journal_fields)
            point("the journal's limits", records.check_nothing_suppressed)
            foreign.result()
        point("a purge", lambda: self._packages.purge(machine))

    def _look_foreign(self, sandbox: Sandbox) -> None:
        self._report.run_check("a foreign address", sandbox.check_addresses)
        self._report.run_check("a foreign device", sandbox.check_devices)


def _end_undisturbed() -> None:
    """Ignore a second order to end, so that nothing is left behind."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
