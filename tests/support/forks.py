"""Processes of `heliocube` that begin as copies of one that has imported everything.

To import it takes one or two seconds of a processor, and the tests start some two hundred. A copy is a process of its
own in every other respect: its arguments, its surroundings, its files, its signals, its exit code. That the program
also starts from nothing is shown where that is the point, with subprocess: in tests/system/test_run.py,
test_deploy.py and others.
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
    *("daemon.commands.kept", "daemon.dashboard.serve", "sim_drivers.bench.bench", "sim_drivers.bench.control"),
    *("pvlib.spa", "nidaqmx._grpc_interpreter", "nidaqmx.stream_writers", "pyvisa_py", "psutil"),
)
_MOST = 1 << 20
_HEAR_EVERY_S = 0.02
# What an interpreter or a library reads when it begins, and not again.
_READ_ONCE = ("PYTHON", "LD_", "OPENBLAS", "OMP_")


class _Origin:
    """The process that is copied, seen from one process of tests; its copies end with that one.

    Parameters
    ----------
    given
        What `told` of another process's has returned, to ask the same one; without it a process is started.
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
            # The system finds a name, which is gone with the process.
            door.bind(b"")
            door.listen(64)
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.forks", str(door.fileno())],
                pass_fds=[door.fileno()],
                cwd=Path(__file__).parents[2],
                # A thread of a library would not be in the copy.
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )
            return {"address": door.getsockname().hex(), "surroundings": _read_once(os.environ)}

    @property
    def pid(self):
        """Of the process, where this one has started it."""
        return None if self._process is None else self._process.pid

    def told(self):
        """Return what another process needs to ask the same one."""
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
        """Return how a copy ended, or None."""
        with self._lock:
            self._listen()
            return self._ended.get(pid)

    def running(self):
        """Return the commands of the copies that this process has begun and that have not ended, by number."""
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


def kept():
    """Return the process that is copied, if it is a child of this one, and the descriptor on which it is asked.

    In lists that may be empty.
    """
    if _origin is None:
        return [], []
    return [pid for pid in [_origin.pid] if pid is not None], [_origin.fileno()]


def running():
    """Return the commands of this process's copies that have not ended, by their numbers."""
    return {} if _origin is None else _origin.running()


def begin():
    """Start the process that is copied, or turn to that of the whole run, unless that is done."""
    global _origin
    if _origin is None:
        _origin = _Origin(_given)
    return _origin


def pytest_configure(config):
    """Take from the process that deals out the tests, if there is one, what is copied for all."""
    global _given
    _given = getattr(config, "workerinput", {}).get("origin")


def pytest_configure_node(node):
    """Let all workers have copies of one process: each would need seconds to load the same."""
    node.workerinput["origin"] = begin().told()


def pytest_unconfigure():
    """End it, and with it whatever is left of its copies."""
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
    """A process of `heliocube`, with what the tests use of subprocess.Popen."""

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
    """Start `heliocube` with arguments; streams are open files or descriptors, and by itself it has nothing to read.

    A process whose surroundings differ in what is read at the start of an interpreter starts from nothing.
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
    """Run `heliocube` to its end, and return what subprocess.run with capture_output and text does."""
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


# What follows runs in the process that is copied, and in the copies.


def _serve(door):
    """Copy this process for every order, and tell of each end; return in a copy, with its order.

    The first who comes has started this process, which ends when that one leaves; with each who leaves his copies end.
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
        # Who leaves may not have heard all that was said.
        return b"", []


@functools.cache
def _load():
    """Import everything, when somebody wants it."""
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
    """Turn a copy into what was ordered."""
    for number, file in enumerate(files):
        os.dup2(file, number)
    for file in files:
        os.close(file)
    os.chdir(order["cwd"])
    os.environ.clear()
    os.environ.update(order["environment"])
    time.tzset()
    # A script has none, and messages begin with its name.
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
    """End as an interpreter does, but leave what is in memory to the system: freeing it takes most of a short copy."""
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
    # A person's Ctrl-C at the tests is theirs.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    order, files = _serve(socket.socket(fileno=int(sys.argv[1])))
    from daemon.entry import main  # noqa: PLC0415 - the copies' business

    signal.signal(signal.SIGINT, signal.default_int_handler)
    _become(order, files)
    _run_to_the_end(main)


if __name__ == "__main__":
    _main()
