"""The cube's role needs nothing of POSIX and no NI software, so that it can run beside the USB-6008 on Windows."""

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

from tests.support import ROOT

pytestmark = pytest.mark.system

POSIX_ONLY = ("fcntl", "termios", "tty", "pty", "grp", "pwd", "resource", "syslog", "posix_ipc", "readline", "curses")
NOT_NEEDED = ("serial", "pyvisa", "pyvisa_py", "nidaqmx", "grpc")
SERVICE = ROOT / "deploy" / "windows" / "heliocube-cube.xml"
# Of the elements that the documentation of WinSW 2.12 lists, those that a service like ours can want.
WINSW = {
    *("id", "name", "description", "executable", "argument", "env", "startmode", "delayedAutoStart", "depend"),
    *("stoptimeout", "onfailure", "resetfailure", "serviceaccount", "logpath", "log", "workingdirectory", "priority"),
}
# What the standard library of Linux itself does without once it is loaded.
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


def without(modules, code):
    """Run code in a process of its own in which these modules cannot be imported."""
    hide = textwrap.dedent(f"""
        import sys
        hidden = {set(modules)!r}
        for name in hidden:
            sys.modules.pop(name, None)
        class Hide:
            def find_spec(self, name, path=None, target=None):
                if name.partition(".")[0] in hidden:
                    raise ModuleNotFoundError(f"{{name}} is hidden", name=name)
        sys.meta_path.insert(0, Hide())
        sys.builtin_module_names = tuple(set(sys.builtin_module_names) - hidden)
    """)
    return subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", "-c", hide + textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def heliocube(hidden, *arguments):
    """Give a command in a process in which these modules are hidden, and with those of POSIX all else of Windows."""
    command = f"from daemon.entry import main\nsys.argv = {['heliocube', *map(str, arguments)]!r}\nmain()"
    return without(hidden, (textwrap.dedent(AS_ON_WINDOWS) if hidden is POSIX_ONLY else "import sys\n") + command)


def run_cube(folder, hidden, text, for_s=1):
    """Run the cube's role for some seconds on a configuration, in a process in which these modules are hidden."""
    (folder / "heliocube.toml").write_text(text)
    return heliocube(hidden, "run", "--role", "cube", "--for", for_s, "--config", folder / "heliocube.toml")


def arguments_of_the_service(program_data):
    """Return what the service of Windows gives to heliocube, with its data in a folder of this machine."""
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
    works(run_cube(tmp_path, NOT_NEEDED, BRIDGE + EVERYTHING), tmp_path)


def test_the_service_of_windows_runs_the_cube_where_nothing_of_posix_is(tmp_path):
    folder = tmp_path / "heliocube"
    made = heliocube(POSIX_ONLY, "config", "init", folder, "--role", "cube")
    assert made.returncode == 0, made.stderr
    (folder / "cube.toml").write_text(SIGNED + EVERYTHING)
    works(heliocube(POSIX_ONLY, *arguments_of_the_service(tmp_path), "--for", "1"), folder)
    names = [PureWindowsPath(path.relative_to(tmp_path)) for path in folder.rglob("*")]
    assert len(names) > 4
    assert [str(name) for name in names if name.is_reserved() or re.search(r'[<>:"|?*]|[. ]$', str(name))] == []


def test_the_service_of_windows_is_described_in_words_of_its_wrapper():
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
def test_what_is_locked_is_all_that_a_system_needs(surroundings):
    locked = {}
    for line in (ROOT / "deploy" / "lock" / "runtime.txt").read_text(encoding="utf-8").splitlines():
        if line[:1].isalnum():
            requirement = Requirement(line.rstrip(" \\"))
            if requirement.marker is None or requirement.marker.evaluate(surroundings):
                locked[canonicalize_name(requirement.name)] = requirement
    assert ("colorama" in locked) == (surroundings is WINDOWS)
    # It has no requirements of its own, and is not installed here.
    names = ["heliocube", *(name for name in locked if name not in ("colorama", "pywin32"))]
    needed = {
        canonicalize_name(requirement.name)
        for name in names
        for requirement in map(Requirement, distribution(name).requires or ())
        if requirement.marker is None or requirement.marker.evaluate(surroundings)
    }
    assert sorted(needed - locked.keys()) == []


def test_a_bench_is_refused_in_a_sentence_where_there_are_no_terminals(tmp_path):
    done = heliocube(POSIX_ONLY, "bench", "--dir", tmp_path / "bench")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "pseudo-terminals" in done.stderr


def works(done, folder):
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stderr
    assert "instruments of the cube are open" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in (folder / "records").iterdir() if path.suffix == ".sqlite"]


def test_the_cubes_role_with_real_instruments_waits_for_them_without_posix(tmp_path):
    done = run_cube(tmp_path, POSIX_ONLY, BRIDGE + REAL, for_s=4)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("the cube is down: voltmeter: NI-VISA is not installed on this PC") == 1
    assert "Traceback" not in done.stderr


def test_every_module_of_the_service_can_be_imported_without_them():
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
