"""Processes of `heliocube` that begin as copies of one that has imported everything.

Imports take one or two seconds of a processor, and the tests start some two hundred processes. A copy is a process of
its own in every other respect: arguments, environment, files, signals, exit code. Tests whose point is that the program
starts from nothing use subprocess: tests/system/test_run.py, test_deploy.py and others.
"""

import atexit
import contextlib
import functools
import gc
import importlib
import io
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.support import PATIENCE_S

IMPORTED = (
    *(
        "daemon.entry",
        "daemon.commands.main",
        "daemon.commands.run",
        "daemon.rigs.real",
        "daemon.rigs.simulated",
        "daemon.rigs.bench",
    ),
    *(
        "daemon.commands.records_folder",
        "daemon.dashboard.serve",
        "sim_drivers.bench.bench",
        "sim_drivers.bench.control",
    ),
    *("pvlib.spa", "nidaqmx._grpc_interpreter", "nidaqmx.stream_writers", "pyvisa_py", "psutil"),
)
_MOST = 1 << 20
_HEAR_EVERY_S = 0.02
# Variables that an interpreter or a library reads at its start only.
_READ_ONCE = ("PYTHON", "LD_", "OPENBLAS", "OMP_")


class _Origin:
    """The process that is copied, as one process of tests sees it; the copies end with the process of tests.

    Parameters
    ----------
    given
        What `told` returned in another process of tests, to use the same original; without it one is started.
    """

    def __init__(self, given=None):
        self._process = None
        if given is None:
            given = self._start()
        self._given = given
        self.surroundings = given["surroundings"]
        self._here = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._here.connect(bytes.fromhex(given["address"]))
        self._running, self._ended = {}, {}
        self._lock = threading.Lock()

    def _start(self):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as door:
            # The system chooses a free name, which vanishes with the process.
            door.bind(b"")
            door.listen(64)
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.forks", str(door.fileno())],
                pass_fds=[door.fileno()],
                cwd=Path(__file__).parents[2],
                # A library's thread would not exist in the copy.
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            return {"address": door.getsockname().hex(), "surroundings": _read_once(os.environ)}

    @property
    def pid(self):
        """The number of the process that is copied, if this process has started it."""
        return None if self._process is None else self._process.pid

    def told(self):
        """Return what another process of tests needs to use the same original."""
        return self._given

    def start(self, arguments, environment, cwd, files):
        order = json.dumps({"arguments": arguments, "environment": environment, "cwd": cwd})
        with self._lock:
            socket.send_fds(self._here, [order.encode()], files)
            while True:
                heard = self._hear()
                if "started" in heard:
                    self._running[heard["started"]] = " ".join(["heliocube", *arguments])
                    return heard["started"]

    def ended(self, pid):
        """Return a copy's exit code, or None."""
        with self._lock:
            self._listen()
            return self._ended.get(pid)

    def running(self):
        """Return the commands of the copies that this process has started and that have not ended, by process id."""
        with self._lock:
            self._listen()
            return {pid: words for pid, words in self._running.items() if pid not in self._ended}

    def _listen(self):
        while selectable(self._here):
            self._hear()

    def _hear(self):
        heard = self._here.recv(_MOST)
        if not heard:
            raise RuntimeError("the process that is copied has ended")
        said = json.loads(heard)
        if "ended" in said:
            self._ended[said["ended"]] = said["code"]
        return said

    def fileno(self):
        return self._here.fileno()

    def close(self):
        self._here.close()
        if self._process is not None:
            self._process.wait()


_origin: _Origin | None = None
_given: dict | None = None


def origin_handles():
    """Return the process that is copied, if it is a child of this one, and the descriptor of the connection to it.

    Two lists, which may be empty.
    """
    if _origin is None:
        return [], []
    return [pid for pid in [_origin.pid] if pid is not None], [_origin.fileno()]


def running():
    """Return the commands of this process's copies that have not ended, by process id."""
    return {} if _origin is None else _origin.running()


def begin():
    """Start the process that is copied, or connect to the run's, unless that is done."""
    global _origin
    if _origin is None:
        _origin = _Origin(_given)
    return _origin


def pytest_configure(config):
    """Take the address of the process that is copied from pytest-xdist's controller, if there is one."""
    global _given
    _given = getattr(config, "workerinput", {}).get("origin")


def pytest_configure_node(node):
    """Let all workers copy one process: each would need seconds to import the same."""
    node.workerinput["origin"] = begin().told()


def pytest_unconfigure():
    """End the process that is copied, and with it what is left of its copies."""
    global _origin
    if _origin is not None:
        _origin.close()
        _origin = None


def selectable(one):
    with selectors.DefaultSelector() as selector:
        selector.register(one, selectors.EVENT_READ)
        return bool(selector.select(0))


def _read_once(environment):
    return {name: value for name, value in environment.items() if name.startswith(_READ_ONCE)}


class Fork:
    """A process of `heliocube`, with those methods of subprocess.Popen that the tests use."""

    def __init__(self, arguments, stdin, stdout, stderr, environment, cwd):
        self._origin = begin()
        self.args = arguments
        self.returncode = None
        self.pid = self._origin.start(arguments, environment, str(cwd or Path.cwd()), [stdin, stdout, stderr])

    def poll(self):
        if self.returncode is None:
            self.returncode = self._origin.ended(self.pid)
        return self.returncode

    def wait(self, timeout=None):
        deadline_s = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            if deadline_s is not None and time.monotonic() > deadline_s:
                raise subprocess.TimeoutExpired(self.args, timeout)
            time.sleep(_HEAR_EVERY_S)
        return self.returncode

    def send_signal(self, number):
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)


def start(arguments, stdout=None, stderr=None, env=None, cwd=None, stdin=None):
    """Start `heliocube` with arguments; streams are open files or descriptors, standard input is empty unless given.

    If the environment differs in a variable that is read at an interpreter's start, the process starts from nothing.
    """
    arguments = list(map(str, arguments))
    environment = dict(os.environ if env is None else env)
    if _read_once(environment) != begin().surroundings:
        program = Path(sys.executable).with_name("heliocube")
        given = {"stdin": subprocess.DEVNULL if stdin is None else stdin, "stdout": stdout, "stderr": stderr}
        return subprocess.Popen([program, *arguments], **given, env=environment, cwd=cwd)
    with Path(os.devnull).open("rb") as nothing:
        given = zip((stdin, stdout, stderr), (nothing, 1, 2), strict=True)
        files = [_number(usual if file is None else file) for file, usual in given]
        return Fork(arguments, *files, environment, cwd)


def _number(file):
    return file if isinstance(file, int) else file.fileno()


def run(*arguments, env=None, cwd=None):
    """Run `heliocube` to its end, and return what subprocess.run with capture_output and text returns."""
    with contextlib.ExitStack() as stack:
        out, err = (stack.enter_context(_memory(name)) for name in ("out", "err"))
        process = start(arguments, out, err, env, cwd)
        try:
            code = process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired as error:
            process.kill()
            process.wait()
            raise subprocess.TimeoutExpired(error.cmd, PATIENCE_S, _text(out), _text(err)) from None
        return subprocess.CompletedProcess(process.args, code, _text(out), _text(err))


def _memory(name):
    return os.fdopen(os.memfd_create(name), "r+b")


def _text(file):
    file.seek(0)
    return file.read().decode(errors="replace")


# What follows runs in the process that is copied and in the copies.


def _serve(door):
    """Copy this process for every order, and report each end; return in a copy, with its order.

    The first to connect has started this process, which ends when it disconnects. When any disconnects, its copies end.
    """
    first, copies, asking = None, {}, set()
    with selectors.DefaultSelector() as selector:
        selector.register(door, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                one = key.fileobj
                if one is door:
                    asker, _ = door.accept()
                    first = first or asker
                    asking.add(asker)
                    selector.register(asker, selectors.EVENT_READ)
                    continue
                if one in copies:
                    selector.unregister(one)
                    _tell_end(*copies.pop(one), one)
                    continue
                order, files = _next_order(one)
                if not order:
                    for pid, asker in copies.values():
                        if one in (asker, first):
                            os.kill(pid, signal.SIGKILL)
                    if one is first:
                        os._exit(0)
                    selector.unregister(one)
                    asking.remove(one)
                    one.close()
                    continue
                _load()
                pid = os.fork()
                if pid == 0:
                    for kept in (*copies, *(each.detach() for each in (door, *asking))):
                        os.close(kept)
                    return json.loads(order), files
                for file in files:
                    os.close(file)
                one.send(json.dumps({"started": pid}).encode())
                copies[watched := os.pidfd_open(pid)] = pid, one
                selector.register(watched, selectors.EVENT_READ)


def _next_order(asker):
    try:
        return socket.recv_fds(asker, _MOST, 3)[:2]
    except ConnectionResetError:
        # A process that leaves may not have read all messages.
        return b"", []


@functools.cache
def _load():
    """Import everything, at the first order."""
    for name in IMPORTED:
        importlib.import_module(name)
    gc.collect()
    gc.freeze()


def _tell_end(pid, asker, watched):
    _, status = os.waitpid(pid, 0)
    os.close(watched)
    with contextlib.suppress(OSError):
        asker.send(json.dumps({"ended": pid, "code": os.waitstatus_to_exitcode(status)}).encode())


def _become(order, files):
    """Give a copy the files, folder, environment and arguments of its order."""
    for number, file in enumerate(files):
        os.dup2(file, number)
    for file in files:
        os.close(file)
    os.chdir(order["cwd"])
    os.environ.clear()
    os.environ.update(order["environment"])
    time.tzset()
    # A script has no package, and its messages begin with the program's name.
    sys.modules["__main__"].__package__ = None
    sys.argv = [str(Path(sys.executable).with_name("heliocube")), *order["arguments"]]
    sys.stdin, sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            io.open(number, mode, closefd=False),  # noqa: UP020, SIM115 - they live as long as the process
            encoding="utf-8",
            errors="backslashreplace" if number == 2 else "strict",
            line_buffering=number == 2 or os.isatty(number),
        )
        for number, mode in enumerate(("rb", "wb", "wb"))
    )
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr


def _run_to_the_end(call):
    """End as an interpreter does, but leave the memory to the system: freeing it takes most of a short copy's time."""
    try:
        call()
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        threading._shutdown()
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit((end.code or 0) & 0xFF)


def _main():
    # Ctrl-C on the terminal is meant for the tests.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    order, files = _serve(socket.socket(fileno=int(sys.argv[1])))
    from daemon.entry import main  # noqa: PLC0415 - the copies' business

    signal.signal(signal.SIGINT, signal.default_int_handler)
    _become(order, files)
    _run_to_the_end(main)


if __name__ == "__main__":
    _main()
