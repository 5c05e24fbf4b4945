"""The cube's role needs nothing of POSIX and no NI software, so that it can run beside the USB-6008 on Windows."""

import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.system

POSIX_ONLY = ("fcntl", "termios", "tty", "pty", "grp", "pwd", "resource", "syslog", "posix_ipc", "readline", "curses")
NOT_NEEDED = ("serial", "pyvisa", "pyvisa_py", "nidaqmx", "grpc")


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
        [sys.executable, "-c", hide + textwrap.dedent(code)], capture_output=True, text=True, timeout=60, check=False
    )


def run_cube(folder, hidden, text):
    """Run the cube's role for a second on a configuration, in a process in which these modules are hidden."""
    (folder / "heliocube.toml").write_text(text)
    return without(
        hidden,
        f"""
        import sys
        from daemon.entry import main
        sys.argv = "heliocube run --role cube --for 1 --config".split() + [{str(folder / "heliocube.toml")!r}]
        main()
        """,
    )


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


@pytest.mark.parametrize("hidden", [POSIX_ONLY, NOT_NEEDED], ids=["no POSIX", "no instrument libraries"])
def test_the_cubes_role_runs_on_the_simulated_rig_without_them(tmp_path, hidden):
    done = run_cube(tmp_path, hidden, BRIDGE + EVERYTHING)
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stderr
    assert "instruments of the cube are open" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in (tmp_path / "records").iterdir() if path.suffix == ".sqlite"]


def test_the_cubes_role_with_real_instruments_waits_for_them_without_posix(tmp_path):
    done = run_cube(tmp_path, POSIX_ONLY, BRIDGE + REAL)
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
