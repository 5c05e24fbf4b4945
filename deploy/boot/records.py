"""Points about what is kept: the stores of both roles, and the journal."""

import sqlite3
from contextlib import closing
from pathlib import Path

from boot.host import CheckFailed, wait
from boot.machine import Machine
from boot.rig import TRACKER, UNITS

ROLES = ("cube", "tracker")


class Records:
    """The stores, read as files, and the journal, read with all its fields.

    Parameters
    ----------
    machine
        Booted.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def scans(self, role: str) -> set[tuple[str, int]]:
        """Return session and number of every scan in a role's store."""
        path = self._machine.root / "var/lib/heliocube" / role / "heliocube.sqlite"
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, timeout=20)) as store:
            rows = store.execute("SELECT session, sequence FROM scans").fetchall()
        return {(str(session), int(number)) for session, number in rows}

    def check_stores(self, before: dict[str, set[tuple[str, int]]]) -> str:
        """See that no scan that stood in a store before is gone, and that SQLite finds the files whole."""
        for role in ROLES:
            path = self._machine.root / "var/lib/heliocube" / role / "heliocube.sqlite"
            with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, timeout=20)) as store:
                (word,) = store.execute("PRAGMA integrity_check").fetchone()
            if word != "ok":
                raise CheckFailed(f"the {role}'s store: {word}")
            if gone := before[role] - self.scans(role):
                raise CheckFailed(f"{len(gone)} scans are gone from the {role}'s store")
        now = {role: self.scans(role) for role in ROLES}
        sessions = len({session for session, _ in now["cube"]})
        return ", ".join(f"{role} {len(now[role])} scans" for role in ROLES) + f", {sessions} sessions, files whole"

    def check_no_scan_lost(self, before: dict[str, set[tuple[str, int]]]) -> str:
        """See that no number is missing in the cube's store, nor in the tracker's, nor what stood in either before."""
        heard = self.scans("tracker")
        # Each role writes at its own times: the cube may have yet to write what the tracker has just heard.
        made = wait(lambda: self._made(heard), "in the cube's store what the tracker has heard")
        for session in {session for session, _ in made}:
            numbers = sorted(number for one, number in made if one == session)
            if len(numbers) != numbers[-1] + 1:
                raise CheckFailed(f"the cube's store has {len(numbers)} scans up to number {numbers[-1]} of a session")
        if before["cube"] - made or before["tracker"] - heard:
            raise CheckFailed("a store lacks what it had")
        # Scans that are newer than all that the tracker has heard may be on their way.
        newest = {session: max(number for one, number in heard if one == session) for session, _ in heard}
        missed = {(one, number) for one, number in made - before["cube"] if number < newest.get(one, 0)} - heard
        if missed:
            raise CheckFailed(f"the tracker did not hear {len(missed)} of {len(made)} scans")
        return f"each of {len(made)} scans is in the cube's store, and none since is missing in the tracker's"

    def _made(self, heard: set[tuple[str, int]]) -> set[tuple[str, int]]:
        """Return the cube's scans once all that were heard are among them; else none."""
        made = self.scans("cube")
        return made if heard <= made else set()

    def check_journal_fields(self) -> str:
        """See that the journal knows the owner and the urgency of each line, and has its fields."""
        entries = self._machine.journal_entries(f"_SYSTEMD_UNIT={TRACKER}")
        urgencies = {str(entry["PRIORITY"]) for entry in entries}
        owners = {str(entry.get("SYSLOG_IDENTIFIER")) for entry in entries}
        with_fields = [str(entry["MESSAGE"]) for entry in entries if "a_deg=" in str(entry["MESSAGE"])]
        if not {"4", "6"} <= urgencies or owners != {"heliocube"} or not with_fields:
            raise CheckFailed(
                f"urgencies {sorted(urgencies)}, of {sorted(owners)}, {len(with_fields)} lines with a_deg="
            )
        if any(str(entry["MESSAGE"]).startswith("<") for entry in entries):
            raise CheckFailed("a line begins with its urgency, which systemd has not read")
        urgency = "".join(sorted(urgencies))
        return f'{len(entries)} lines of {owners.pop()}, urgencies {urgency}, "{with_fields[0][:90]}"'

    def check_nothing_suppressed(self) -> str:
        """See that no line of ours was thrown away because there were too many."""
        said = self._machine.journal_entries("_COMM=systemd-journal")
        dropped = [str(entry["MESSAGE"]) for entry in said if "uppressed" in str(entry["MESSAGE"])]
        if dropped:
            raise CheckFailed("; ".join(dropped[:3]))
        lines = {unit: len(self._machine.journal_entries(f"_SYSTEMD_UNIT={unit}")) for unit in UNITS}
        return ", ".join(
            ["nothing suppressed", *(f"{unit.split('.')[0]} {count} lines" for unit, count in lines.items())]
        )


def store_files(root: Path) -> list[Path]:
    """Return the files of the records in a tree."""
    return sorted(path for path in (root / "var/lib/heliocube").rglob("*") if path.is_file())
