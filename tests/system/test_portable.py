"""The cube's role needs nothing of POSIX and no NI software, so that it can run beside the USB-6008 on Windows."""

import json
import os
import re
import subprocess
import sys
import textwrap
from importlib.metadata import distribution
from pathlib import PureWindowsPath
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support import PATIENCE_S, ROOT

pytestmark = pytest.mark.system

POSIX_ONLY = ("fcntl", "termios", "tty", "pty", "grp", "pwd", "resource", "syslog", "posix_ipc", "readline", "curses")
NOT_NEEDED = ("serial", "pyvisa", "pyvisa_py", "nidaqmx", "grpc")
# Characters, endings and whole names that no file on Windows can have.
NOT_OF_WINDOWS = r"""(?i)[<>:"|?*]|[. ](\\|$)|(^|\\)(con|prn|aux|nul|com\d|lpt\d)(\.|\\|$)"""
SERVICE = ROOT / "deploy" / "windows" / "heliocube-cube.xml"
# Of the elements that the documentation of WinSW 2.12 lists, those that a service like ours can want.
WINSW = {
    *("id", "name", "description", "executable", "argument", "env", "startmode", "delayedAutoStart", "depend"),
    *("stoptimeout", "onfailure", "resetfailure", "serviceaccount", "logpath", "log", "workingdirectory", "priority"),
}
# Names that Windows lacks and that Linux's own standard library does without once it is loaded.
NOT_ON_WINDOWS = {
    "os": "fork forkpty getuid geteuid getgid getegid getgroups setuid setgid fchown chown lchown killpg setsid"
    " getpgid getpgrp mkfifo mknod openpty ttyname tcgetpgrp pread pwrite sendfile nice getloadavg sync chroot wait3"
    " wait4 sched_getaffinity sched_setaffinity posix_fadvise posix_fallocate O_NOCTTY O_NOFOLLOW O_DIRECTORY O_SYNC",
    "signal": "SIGHUP SIGUSR1 SIGUSR2 SIGKILL SIGALRM SIGCHLD SIGPIPE SIGQUIT SIGCONT SIGSTOP SIGTSTP SIGWINCH alarm"
    " setitimer pause sigwait pthread_kill pthread_sigmask",
    "socket": "AF_UNIX SO_REUSEPORT CMSG_LEN SCM_RIGHTS AF_NETLINK AF_PACKET MSG_DONTWAIT",
}
AS_ON_WINDOWS = f"""
    import asyncio, contextlib, importlib, multiprocessing, os, signal, socket, ssl, subprocess, tempfile, warnings
    # Libraries that have other parts on Windows, of which there is nothing here.
    for name in "aiomqtt httpx pandas pvlib pydantic pyvisa.ctwrapper rich.live serial typer uvicorn".split():
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for module, names in {NOT_ON_WINDOWS!r}.items():
        for name in names.split():
            vars(sys.modules[module]).pop(name, None)
    def unknown(*_):
        raise NotImplementedError
    def pair(*_):
        with socket.create_server(("127.0.0.1", 0)) as server:
            one = socket.create_connection(server.getsockname())
            return one, server.accept()[0]
    socket.socketpair = pair
    asyncio.SelectorEventLoop.add_signal_handler = asyncio.SelectorEventLoop.remove_signal_handler = unknown
    sys.platform = "win32"
    # Without an encoding a file is in that of the country there.
    warnings.filterwarnings("error", category=EncodingWarning, module=r"(solar|drivers|sim_drivers|daemon)\\b")
"""


HIDE = """
    import sys
    hidden = {hidden!r}
    for name in hidden:
        sys.modules.pop(name, None)
    class Hide:
        def find_spec(self, name, path=None, target=None):
            if name.partition(".")[0] in hidden:
                raise ModuleNotFoundError(f"{{name}} is hidden", name=name)
    sys.meta_path.insert(0, Hide())
    sys.builtin_module_names = tuple(set(sys.builtin_module_names) - hidden)
"""
COPIED = """
    import daemon.entry, daemon.commands.main, daemon.commands.run, json
    for line in sys.stdin:
        words, *outputs = json.loads(line)
        if not (copy := fork()):
            break
        print(waitpid(copy, 0)[1], flush=True)
    else:
        os._exit(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number, file in enumerate([nothing, *(os.open(output, os.O_WRONLY) for output in outputs)]):
        os.dup2(file, number)
    sys.argv = ["heliocube", *words]
    daemon.entry.main()
"""


def python_without(modules, *parts):
    """Return a command that runs these parts in turn, in a process in which these modules cannot be imported."""
    code = "\n".join(map(textwrap.dedent, (HIDE.format(hidden=set(modules)), *parts)))
    return [sys.executable, "-X", "warn_default_encoding", "-c", code]


def without(modules, code):
    """Run code in a process of its own in which these modules cannot be imported."""
    return subprocess.run(
        python_without(modules, code), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


@pytest.fixture(scope="module")
def copied_on_windows():
    """A process with all that `heliocube run` loads and nothing of POSIX, which runs copies of itself."""
    code = python_without(POSIX_ONLY, "import os\nfork, waitpid = os.fork, os.waitpid", AS_ON_WINDOWS, COPIED)
    with subprocess.Popen(code, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as origin:
        yield origin


@pytest.fixture
def on_windows(copied_on_windows, tmp_path_factory):
    """Run a command in a copy of a process without anything of POSIX: loading it all takes longer than any command."""

    def heliocube(*arguments):
        outputs = [tmp_path_factory.mktemp("said") / name for name in ("out", "err")]
        for output in outputs:
            output.touch()
        words = [[*map(str, arguments)], *map(str, outputs)]
        copied_on_windows.stdin.write(json.dumps(words) + "\n")
        copied_on_windows.stdin.flush()
        status = copied_on_windows.stdout.readline()
        assert status, "what is copied has ended: it cannot be imported there"
        code = os.waitstatus_to_exitcode(int(status))
        return subprocess.CompletedProcess(arguments, code, *(output.read_text() for output in outputs))

    return heliocube


def cube(folder, text, for_s=1):
    """Write a configuration, and return the command that runs the cube's role on it for some seconds."""
    config = folder / "heliocube.toml"
    config.write_text(text)
    return "run", "--role", "cube", "--for", str(for_s), "--config", str(config)


def arguments_of_the_service(program_data):
    """Return the arguments that the Windows service gives to heliocube, with its data in a folder of this machine."""
    given = [each.text for each in ET.parse(SERVICE).getroot().iter("argument")]
    return [text.replace("%ProgramData%", str(program_data)).replace("\\", "/") for text in given]


LINUX = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "extra": ""}
WINDOWS = {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt", "extra": ""}
SIGNED = "[bridge]\nkey_file = 'bridge.key'\nsend_to = ['127.0.0.1:20999']\n"
BRIDGE = "[bridge]\ninsecure = true\nsend_to = ['127.0.0.1:20999']\n"
EVERYTHING = """
[simulation]
speed = 20.0
[store]
directory = "records"
[api]
listen = "127.0.0.1:0"
[mqtt]
enabled = true
host = "127.0.0.1"
port = 9
"""
REAL = """
[api]
enabled = false
[instruments]
kind = "real"
[instruments.voltmeter]
resource = "GPIB0::16::INSTR"
visa = "ni"
"""


def test_the_cubes_role_runs_on_the_simulated_rig_without_instrument_libraries(tmp_path):
    words = ["heliocube", *cube(tmp_path, BRIDGE + EVERYTHING)]
    works(without(NOT_NEEDED, f"from daemon.entry import main\nsys.argv = {words}\nmain()"), tmp_path)


def test_the_windows_service_runs_the_cube_without_posix_and_with_file_names_valid_on_windows(on_windows, tmp_path):
    folder = tmp_path / "heliocube"
    made = on_windows("config", "init", folder, "--role", "cube")
    assert made.returncode == 0, made.stderr
    (folder / "cube.toml").write_text(SIGNED + EVERYTHING)
    works(on_windows(*arguments_of_the_service(tmp_path), "--for", "1"), folder)
    names = [PureWindowsPath(path.relative_to(tmp_path)) for path in folder.rglob("*")]
    assert len(names) > 4
    assert [name for name in map(str, names) if re.search(NOT_OF_WINDOWS, name)] == []


def test_the_windows_service_file_has_only_elements_of_its_wrapper_winsw_and_absolute_paths():
    service = ET.parse(SERVICE).getroot()
    assert service.tag == "service"
    assert {each.tag for each in service} <= WINSW
    roots = {"%ProgramFiles%": r"C:\Program Files", "%ProgramData%": r"C:\ProgramData"}
    paths = [
        service.findtext("executable"),
        service.findtext("logpath"),
        arguments_of_the_service(roots["%ProgramData%"])[-1],
    ]
    for path in paths:
        for name, folder in roots.items():
            path = path.replace(name, folder)
        assert PureWindowsPath(path).is_absolute(), path
        assert "%" not in path


@pytest.mark.parametrize("surroundings", [WINDOWS, LINUX], ids=["windows", "linux"])
def test_the_lock_file_has_every_requirement_of_the_system(surroundings):
    locked = {}
    for line in (ROOT / "deploy" / "lock" / "runtime.txt").read_text(encoding="utf-8").splitlines():
        if line[:1].isalnum():
            requirement = Requirement(line.rstrip(" \\"))
            if requirement.marker is None or requirement.marker.evaluate(surroundings):
                locked[canonicalize_name(requirement.name)] = requirement
    assert ("colorama" in locked) == (surroundings is WINDOWS)
    # These two have no requirements of their own, and are not installed here.
    names = ["heliocube", *(name for name in locked if name not in ("colorama", "pywin32"))]
    needed = {
        canonicalize_name(requirement.name)
        for name in names
        for requirement in map(Requirement, distribution(name).requires or ())
        if requirement.marker is None or requirement.marker.evaluate(surroundings)
    }
    assert sorted(needed - locked.keys()) == []


def test_a_bench_is_refused_in_one_sentence_where_there_are_no_pseudo_terminals(on_windows, tmp_path):
    done = on_windows("bench", "--dir", tmp_path / "bench")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "pseudo-terminals" in done.stderr


def works(done, folder):
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stderr
    assert "instruments of the cube are open" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in (folder / "records").iterdir() if path.suffix == ".sqlite"]


def test_the_cubes_role_with_real_instruments_waits_for_them_without_posix(on_windows, tmp_path):
    done = on_windows(*cube(tmp_path, BRIDGE + REAL, for_s=4))
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("the cube is down: voltmeter: NI-VISA is not installed on this PC") == 1
    assert "Traceback" not in done.stderr


def test_every_module_of_the_service_can_be_imported_without_posix_and_instrument_libraries():
    done = without(
        (*POSIX_ONLY, *NOT_NEEDED),
        """
        import pkgutil, importlib
        import daemon, drivers
        for package in (drivers, daemon):
            for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
                importlib.import_module(module.name)
        """,
    )
    assert done.returncode == 0, done.stderr
