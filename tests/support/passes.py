"""Both parts of the suite at once: what computes fills the time in which what passes real time waits.

Both have the same share of the processors. With a smaller one for what computes (`nice`), and with a larger one for
instruments, Linux 6.18 let the thread that carries what is written to a pseudo-terminal wait for seconds.
"""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_RESULTS = re.compile(r"=+ (FAILURES|ERRORS|warnings summary|short test summary info|no tests ran|\d+ )")
# As pytest has them.
_INTERRUPTED, _NOTHING_COLLECTED = 2, 5


class Pass:
    """One run of pytest, whose lines are told by its name as they come, and its results in one piece.

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
        """Return its exit code when it has ended and told all."""
        while True:
            try:
                self._teller.join()
                return self._process.wait()
            except KeyboardInterrupt:
                # The terminal has told pytest too, which ends in good order.
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
    """Return the one code for all: an interruption first, then a failure; to find no test is one if none finds any."""
    if _INTERRUPTED in codes:
        return _INTERRUPTED
    return next((code for code in codes if code not in (0, _NOTHING_COLLECTED)), min(codes))


def run(waiting, computing, *, at_once, say):
    """Run both commands, at once or one after the other, and return the exit code for both."""
    if not at_once:
        return exit_code([Pass("computing", computing, say).wait(), Pass("waiting", waiting, say).wait()])
    both = [Pass("computing", computing, say), Pass("  waiting", waiting, say)]
    return exit_code([one.wait() for one in both])


def _say(text):
    sys.stdout.write(text)
    sys.stdout.flush()


def main(workers, waiting, *arguments):
    """Run the whole suite with so many processes for what computes and what waits, and arguments of pytest for both."""
    given = ("--color=yes", *arguments) if sys.stdout.isatty() else arguments
    pytest = (sys.executable, "-m", "pytest", "--dist", "worksteal")
    live = (*pytest, "--live", "only", "-n", waiting, "-o", "cache_dir=.pytest_cache/live", *given)
    computing = (*pytest, "--live", "without", "-n", workers, *given)
    return run(live, computing, at_once=len(os.sched_getaffinity(0)) > 1, say=_say)


if __name__ == "__main__":
    os.chdir(Path(__file__).parents[2])
    sys.exit(main(*sys.argv[1:]))
