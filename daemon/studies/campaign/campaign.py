"""What `heliocube campaign` does: carries schedules out, and reduces what fails."""

from collections.abc import Callable
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.studies.campaign.many import CampaignSummary, run_many
from daemon.studies.campaign.reduce import reduce_schedule
from daemon.studies.campaign.run import CampaignOutcome
from daemon.studies.campaign.schedule import Schedule
from daemon.studies.spread.workers import Workers

_BROKEN, _INTERRUPTED = 1, 130


class Campaign:
    """Carries out the schedules of a campaign and says what they show.

    Parameters
    ----------
    schedules
        What happens.
    workers
        Who carries them out; failures are reduced in this process.
    say
        Called with what people are to read.
    keep
        Folder for failures, made with the first one. Each is written whole as soon as it is seen, and reduced later.
    show
        Whether each schedule and its log are printed.

    Attributes
    ----------
    summary
        What the last `run` has shown.
    """

    def __init__(
        self, schedules: list[Schedule], workers: Workers, say: Callable[[str], None], keep: Path, *, show: bool
    ) -> None:
        self._schedules = schedules
        self._workers = workers
        self._say = say
        self._failure_folder = keep
        self._show = show
        self.summary = CampaignSummary()

    def run(self, progress: Callable[[float], None]) -> int:
        """Carry them out, reduce what fails, and return an exit code; `progress` takes the share done, 0..1.

        1: a promise was broken. 130: none was, but Ctrl-C ended the campaign before all were carried out. Raises
        `WorkersError` if no worker is left to carry them out, after it has said what was done by then.
        """
        done = 0

        def note(schedule: Schedule, outcome: CampaignOutcome) -> None:
            nonlocal done
            done += 1
            progress(done / len(self._schedules))
            self._report_outcome(schedule, outcome)

        self.summary = summary = run_many(self._schedules, self._workers, note, with_log=self._show)
        for line in summary.lines():
            self._say(line)
        left = len(self._schedules) - summary.done
        if left:
            self._say(f"ended before {left} more")
            if summary.workers_error is not None:
                raise summary.workers_error
        else:
            self._reduce_all(sorted(summary.failed, key=_seed))
        if summary.failed:
            return _BROKEN
        return _INTERRUPTED if left else 0

    def _reduce_all(self, failed: list[tuple[Schedule, CampaignOutcome]]) -> None:
        for at, (schedule, outcome) in enumerate(failed):
            try:
                self._reduce(schedule, outcome)
            except KeyboardInterrupt:
                seeds = ", ".join(str(later.seed) for later, _ in failed[at:])
                self._say(f"ended before these seeds were reduced: {seeds}")
                return

    def _report_outcome(self, schedule: Schedule, outcome: CampaignOutcome) -> None:
        if self._show:
            self._say(schedule.text())
            for at_s, level, name, text in outcome.lines:
                self._say(f"{at_s:9.2f} s  {level} {name.removeprefix('heliocube.')}: {text}")
        for violation in outcome.violations:
            self._say(f"seed {schedule.seed}: {violation}")
        if outcome.violations:
            # Other seeds may run for hours before this failure is reduced, and Ctrl-C may end them.
            try:
                self._say(f"again: heliocube campaign --schedule {self._write(schedule)} --show")
            except UserError as error:
                self._say(str(error))

    def _reduce(self, schedule: Schedule, outcome: CampaignOutcome) -> None:
        first = outcome.violations[0]
        reduced = reduce_schedule(schedule, {first.promise}, first.at_s)
        path = self._write(reduced)
        self._say(f"reduced to {len(reduced.events)} events, heliocube campaign --schedule {path}:")
        self._say(reduced.text())

    def _write(self, schedule: Schedule) -> Path:
        path = self._failure_folder / f"seed-{schedule.seed}.json"
        try:
            replace_file(path, schedule.json() + "\n")
        except OSError as error:
            raise UserError(f"--keep: {path} cannot be written: {error}") from error
        return path


def _seed(failed: tuple[Schedule, CampaignOutcome]) -> int:
    return failed[0].seed
