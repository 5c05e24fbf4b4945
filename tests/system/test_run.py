"""`heliocube run` as a person starts it."""

import collections
import contextlib
import fcntl
import os
import pty
import signal
import socket
import subprocess
import sys
import termios
from datetime import UTC, datetime
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import daemon
from tests.support import PATIENCE_S, ROOT, forks

pytestmark = pytest.mark.system


def hung_up_on():
    """Give a process the handling of SIGHUP that it has at a terminal: the tests may have been started under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def at_a_terminal():
    hung_up_on()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def test_the_embedded_default_runs_ends_by_itself_and_shows_that_it_is_simulated(tmp_path):
    result = subprocess.run(
        [sys.executable, "-m", "daemon.commands.main", "run", "--for", "6"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert result.returncode == 0, result.stderr
    assert "SIMULATED" in result.stdout
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_sigint_sigterm_and_sighup_stop_motion_and_end_the_service_with_exit_code_0(number):
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.commands.main", "run", "--speed", "30"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hung_up_on,
    )
    lines = []
    for line in process.stderr:
        lines.append(line)
        if "moving" in line:
            break
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "motion stopped" in err
    assert "Traceback" not in err
    assert "ended at" in out


def test_repeated_ctrl_c_does_not_disturb_the_shutdown_that_the_first_one_began(tmp_path):
    (tmp_path / "heliocube.toml").write_text(f"[store]\ndirectory = '{tmp_path}/records'\n[api]\nenabled = false\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.commands.main", "run", "--config", tmp_path / "heliocube.toml", "--speed", "30"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert any("moving" in line for line in process.stderr)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert out.splitlines()[-1].endswith("; motion is stopped")
    assert "interrupted" not in err


def test_signals_while_the_service_ends_by_itself_do_not_disturb_its_shutdown():
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.commands.main", "run", "--for", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert any(line.startswith("ended at") for line in process.stdout)
    while process.poll() is None:
        for number in (signal.SIGINT, signal.SIGTERM):
            process.send_signal(number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert "interrupted" not in err
    assert "Traceback" not in err


def test_a_terminal_that_is_closed_ends_the_service_in_good_order():
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.commands.main", "run", "--speed", "30"],
        stdin=theirs,
        stdout=theirs,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=at_a_terminal,
    )
    os.close(theirs)
    shown = b""
    while b"tracking" not in shown:
        shown += os.read(ours, 65536)
    os.close(ours)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "Traceback" not in err


def test_under_nohup_the_service_outlives_its_terminal():
    process = subprocess.Popen(
        ["nohup", sys.executable, "-m", "daemon.commands.main", "run", "--speed", "30"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert any("decision" in line or "moving" in line for line in process.stderr)
        process.send_signal(signal.SIGHUP)
        assert any("moving" in line for line in process.stderr)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "motion stopped" in err


def test_the_service_works_although_nothing_can_be_printed_and_then_exits_with_code_7(tmp_path):
    told = tmp_path / "told"
    with Path("/dev/full").open("w") as full, told.open("w") as err:
        code = forks.start(["run", "--speed", "30", "--for", "5"], full, err, cwd=tmp_path).wait(PATIENCE_S)
    assert code == 7
    assert "motion stopped" in told.read_text()
    assert "Traceback" not in told.read_text()
    assert told.read_text().endswith("cannot be written to standard output: No space left on device\n")


def test_a_port_in_use_is_refused_with_its_address(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{holder.getsockname()[1]}"
        config = tmp_path / "heliocube.toml"
        config.write_text(f'[bridge]\nlisten = "{address}"\nsend_to = ["{address}"]\n')
        result = forks.run("run", "--config", str(config), "--for", "1")
    assert result.returncode == 2
    assert f"{address} is in use" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(("bench", "year"), [("false", datetime.now(UTC).year), ("true", 2001)])
def test_a_service_with_real_instruments_has_the_time_of_the_machine_except_on_a_bench(bench, year, tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f'[instruments]\nkind = "real"\nbench = {bench}\n[instruments.positioner]\nport = "/dev/no-such-port"\n'
        f"[simulation]\nstart_utc = 2001-06-21T12:00:00Z\nanchor_utc = {datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}\n"
        '[bridge]\ninsecure = true\nlisten = "127.0.0.1:0"\n[api]\nenabled = false\n'
    )
    result = forks.run("run", "--role", "tracker", "--config", str(config), "--for", "0.3")
    assert result.returncode == 0, result.stderr
    assert f"ended at {year}-" in result.stdout


def test_a_key_that_others_can_read_is_refused_with_the_remedy(tmp_path):
    assert forks.run("config", "init", str(tmp_path)).returncode == 0
    (tmp_path / "bridge.key").chmod(0o644)
    result = forks.run("run", "--config", str(tmp_path / "heliocube.toml"), "--for", "1")
    assert result.returncode == 2
    assert "chmod 600" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_the_cube_role_alone_without_a_key_is_refused():
    result = forks.run("run", "--role", "cube", "--for", "1")
    assert result.returncode == 2
    assert "heliocube config init" in result.stderr


def test_the_service_manager_is_notified_of_start_watchdog_and_end_of_the_service(tmp_path):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(PATIENCE_S)
        environment = {**os.environ, "NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000"}
        process = subprocess.Popen(
            [sys.executable, "-m", "daemon.commands.main", "run", "--speed", "1", "--start", "2022-10-12T10:00Z"],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        heard = []
        while heard.count("WATCHDOG=1") < 4:
            heard += manager.recv(4096).decode().split("\n")
        # First it hands over the bridge's port, for its successor.
        assert heard[0] == "FDSTORE=1"
        assert heard[2] == "READY=1"
        assert any(line.startswith("STATUS=starting") for line in heard)

        process.send_signal(signal.SIGSTOP)
        manager.settimeout(1.5)
        drained = iter(lambda: manager.recv(4096), b"")
        with pytest.raises(TimeoutError):
            collections.deque(drained, maxlen=0)
        process.send_signal(signal.SIGCONT)

        process.send_signal(signal.SIGTERM)
        manager.settimeout(PATIENCE_S)
        while "STOPPING=1" not in heard:
            heard += manager.recv(4096).decode().split("\n")
        assert process.wait(timeout=PATIENCE_S) == 0


@pytest.mark.parametrize("needed", ["daemon.commands.main", "daemon.config.file, daemon.config.stuck_lines"])
def test_the_help_and_the_check_of_a_configuration_do_not_import_pvlib_or_pandas(needed):
    program = f"import sys, {needed}; print('pvlib' in sys.modules, 'pandas' in sys.modules)"
    imported = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S)
    assert imported.stdout.split() == ["False", "False"]


def test_the_package_daemon_is_ours_and_no_other_installed_distribution_has_one_of_that_name():
    assert Path(daemon.__file__) == ROOT / "daemon" / "__init__.py"
    # Here the folder of the tests comes first; where the program is installed, the one installed last wins.
    assert set(packages_distributions().get("daemon", ())) <= {"heliocube"}
