"""Both parts of the suite at once: the tests that compute fill the time in which the tests on real time wait."""

import contextlib
import os
import platform
import re
import subprocess
import sys
import threading
from pathlib import Path

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_RESULTS = re.compile(r"=+ (FAILURES|ERRORS|warnings summary|short test summary info|no tests ran|\d+ )")
# pytest's own codes.
_INTERRUPTED, _NOTHING_COLLECTED = 2, 5
# The share of the whole session, against all other sessions and the threads of the kernel.
_SHARE = Path("/proc/self/autogroup")
_NICE = re.compile(r"nice (-?\d+)")
SMALL_SHARE = 6
POLITE = "10"
# Linux from 6.12, as some distributions have it, to 6.18.44 computes a session's place in the queue wrongly whenever
# one of its processes begins or ends a wait: docs/develop/tests.md.
_FIRST_WRONG, _FIRST_RIGHT = (6, 12), (6, 18, 45)


class PytestRun:
    """One run of pytest: prints its lines as they come, each behind its name, and its results in one piece.

    Parameters
    ----------
    name
        Before each line.
    command
        What is run.
    say
        Called with text to print.
    """

    def __init__(self, name, command, say):
        self._name = name
        self._say = say
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._teller = threading.Thread(target=self._tell)
        self._teller.start()

    def wait(self):
        """Return its exit code when it has ended and all is printed."""
        while True:
            try:
                self._teller.join()
                return self._process.wait()
            except KeyboardInterrupt:
                # The terminal sends Ctrl-C to pytest too, which ends in good order.
                continue

    def _tell(self):
        results = ""
        for line in self._process.stdout:
            if results or _RESULTS.match(_COLOURS.sub("", line)):
                results += line
            else:
                self._say(f"{self._name} | {line}")
        self._process.stdout.close()
        if results:
            self._say(f"{self._name}:\n{results}")


def exit_code(codes):
    """Return one code for all: an interruption first, then a failure. No test found counts only if no run found any."""
    if _INTERRUPTED in codes:
        return _INTERRUPTED
    return next((code for code in codes if code not in (0, _NOTHING_COLLECTED)), min(codes))


def run(waiting, computing, *, at_once, say):
    """Run both commands, at once or one after the other, and return the exit code for both."""
    if not at_once:
        return exit_code([PytestRun("computing", computing, say).wait(), PytestRun("waiting", waiting, say).wait()])
    both = [PytestRun("computing", computing, say), PytestRun("  waiting", waiting, say)]
    return exit_code([one.wait() for one in both])


def has_session_share_bug(release):
    """Return whether this release of Linux lets the kernel's own threads wait for a session that often waits."""
    numbers = re.match(r"(\d+)\.(\d+)(?:\.(\d+))?", release)
    return numbers is not None and _FIRST_WRONG <= tuple(int(number or 0) for number in numbers.groups()) < _FIRST_RIGHT


@contextlib.contextmanager
def session_share(nice, share=_SHARE):
    """Set this session's share of the processors, as `nice`, until the end, where Linux has such shares."""
    try:
        before = _NICE.search(share.read_text(encoding="ascii"))
    except OSError:
        before = None
    if before is None:
        yield
        return
    share.write_text(str(nice), encoding="ascii")
    try:
        yield
    finally:
        # Only an administrator may raise the share again.
        with contextlib.suppress(OSError):
            share.write_text(before[1], encoding="ascii")


def smaller_session_share(share=_SHARE, release=None):
    """Give this session less than the kernel's threads have, which carry what is written to pseudo-terminals."""
    wrong = has_session_share_bug(platform.release() if release is None else release)
    return session_share(SMALL_SHARE, share) if wrong else contextlib.nullcontext()


def _say(text):
    sys.stdout.write(text)
    sys.stdout.flush()


def main(workers, waiting, *arguments):
    """Run the whole suite with so many processes for what computes and what waits, and arguments of pytest for both."""
    given = ("--color=yes", *arguments) if sys.stdout.isatty() else arguments
    pytest = (sys.executable, "-m", "pytest", "--dist", "worksteal")
    live = (*pytest, "--live", "only", "-n", waiting, "-o", "cache_dir=.pytest_cache/live", *given)
    computing = (*pytest, "--live", "without", "-n", workers, *given)
    at_once = len(os.sched_getaffinity(0)) > 1
    # Computing has no deadline and gets a small share: instruments and services beside it have deadlines.
    polite = ("nice", "-n", POLITE) if at_once else ()
    with smaller_session_share():
        return run(live, (*polite, *computing), at_once=at_once, say=_say)


if __name__ == "__main__":
    os.chdir(Path(__file__).parents[2])
    sys.exit(main(*sys.argv[1:]))
