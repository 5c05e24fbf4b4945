"""The cube's role needs nothing of POSIX and no NI software, so that it can run beside the USB-6008 on Windows."""

import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.system

POSIX_ONLY = ("fcntl", "termios", "tty", "pty", "grp", "pwd", "resource", "syslog")
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


@pytest.mark.parametrize("hidden", [POSIX_ONLY, NOT_NEEDED], ids=["no POSIX", "no instrument libraries"])
def test_the_cubes_role_runs_on_the_simulated_rig_without_them(tmp_path, hidden):
    (tmp_path / "heliocube.toml").write_text(
        "[bridge]\ninsecure = true\nsend_to = ['127.0.0.1:20999']\n[simulation]\nspeed = 20.0\n"
    )
    done = without(
        hidden,
        f"""
        import sys
        from daemon.cli import main
        sys.argv = "heliocube run --role cube --for 1 --config".split() + [{str(tmp_path / "heliocube.toml")!r}]
        main()
        """,
    )
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stderr
    assert "instruments of the cube are open" in done.stderr


def test_every_module_of_the_cubes_role_can_be_imported_without_them():
    done = without(
        (*POSIX_ONLY, *NOT_NEEDED),
        """
        import pkgutil, importlib
        import drivers
        for module in pkgutil.iter_modules(drivers.__path__, "drivers."):
            importlib.import_module(module.name)
        import daemon.composition, daemon.real_rig, daemon.run, daemon.cli_probe
        """,
    )
    assert done.returncode == 0, done.stderr
