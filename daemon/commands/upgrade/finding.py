"""The findings of a self-check: for each subject whether all is well, and if not what to do."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from daemon.base.errors import ExitCode
from daemon.config.keys import printable

CONFIGURATION = "configuration"
_OUTCOME = 8


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of a self-check.

    Attributes
    ----------
    subject
        What was looked at.
    text
        What was found there.
    remedy
        What to do, if something is wrong; empty if all is well.
    """

    subject: str
    text: str
    remedy: str = ""

    @property
    def ok(self) -> bool:
        """Whether all is well."""
        return not self.remedy


def lines(findings: Sequence[Finding]) -> list[str]:
    """Return a line for each finding, and one that sums them up."""
    found = [_line(finding, _width(findings)) for finding in findings]
    amiss = sum(not finding.ok for finding in findings)
    return [*found, f"{amiss} to look at" if amiss else "all is well"]


def exit_code(findings: Iterable[Finding]) -> ExitCode:
    """Return the program's exit code: a wrong file counts more than problems on the rig."""
    amiss = {finding.subject for finding in findings if not finding.ok}
    if CONFIGURATION in amiss:
        return ExitCode.MISTYPED
    return ExitCode.ALARMS if amiss else ExitCode.GOOD


def page(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the findings as JSON."""
    found = [{"subject": each.subject, "ok": each.ok} | asdict(each) for each in findings]
    return {"exit_code": int(exit_code(findings)), "findings": found}


def text_column(findings: Sequence[Finding]) -> int:
    """Return the column in which the texts of the lines begin."""
    return _OUTCOME + 1 + _width(findings) + 2


def _width(findings: Sequence[Finding]) -> int:
    return max(len(finding.subject) for finding in findings)


def _line(finding: Finding, width: int) -> str:
    remedy = f"; {finding.remedy}" if finding.remedy else ""
    # Texts of instruments and other programs are put in one line.
    text = printable(" ".join(f"{finding.text}{remedy}".split()))
    return f"{'ok' if finding.ok else 'PROBLEM':<{_OUTCOME}} {finding.subject:<{width}}  {text}"
