import importlib.util
import os
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from daemon.base.process import SystemdNotifier
from tests.support import PATIENCE_S


@pytest.fixture
def manager(tmp_path):
    """A stand-in for systemd's end of the socket."""
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(path))
        receiver.settimeout(PATIENCE_S)
        yield receiver, str(path)


def test_each_message_arrives_as_one_datagram(manager):
    receiver, path = manager
    notifier = SystemdNotifier({"NOTIFY_SOCKET": path}, pid=7)
    notifier.ready()
    notifier.status("tracking: A 3\nB 60")
    notifier.watchdog()
    notifier.stopping()
    received = [receiver.recv(1000).decode() for _ in range(4)]
    assert received == ["READY=1", "STATUS=tracking: A 3 B 60", "WATCHDOG=1", "STOPPING=1"]


def test_a_leading_at_sign_in_notify_socket_means_an_abstract_socket(tmp_path):
    name = f"heliocube-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind("\0" + name)
        receiver.settimeout(PATIENCE_S)
        SystemdNotifier({"NOTIFY_SOCKET": "@" + name}, pid=7).ready()
        assert receiver.recv(100) == b"READY=1"


def test_the_notifier_does_nothing_without_a_service_manager():
    notifier = SystemdNotifier({}, pid=7)
    notifier.ready()
    notifier.watchdog()
    assert notifier.watchdog_interval_s is None


def test_an_unreachable_service_manager_causes_no_error(tmp_path):
    SystemdNotifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}, pid=7).ready()
    SystemdNotifier({"NOTIFY_SOCKET": "/" + "x" * 300}, pid=7).ready()


def test_the_notifier_does_not_wait_for_a_service_manager_that_does_not_read(manager):
    _, path = manager
    notifier = SystemdNotifier({"NOTIFY_SOCKET": path}, pid=7)
    for _ in range(2000):
        notifier.watchdog()


def test_the_watchdog_interval_is_half_of_the_watchdog_time():
    assert SystemdNotifier({"WATCHDOG_USEC": "10000000"}, pid=7).watchdog_interval_s == 5.0
    assert SystemdNotifier({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "7"}, pid=7).watchdog_interval_s == 5.0


@pytest.mark.parametrize(
    "environment",
    [
        {"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "8"},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": ""},
        {"WATCHDOG_USEC": "soon"},
    ],
)
def test_a_watchdog_of_another_process_or_without_a_valid_time_is_ignored(environment):
    assert SystemdNotifier(environment, pid=7).watchdog_interval_s is None


def test_the_notifier_loads_and_stays_silent_on_a_machine_without_unix_sockets(monkeypatch):
    monkeypatch.delattr(socket, "AF_UNIX")
    # A copy: reloading the module itself gave all later tests a second version of the names that its log lines use.
    found = importlib.util.find_spec(SystemdNotifier.__module__)
    copy = importlib.util.module_from_spec(found)
    found.loader.exec_module(copy)
    copy.SystemdNotifier({"NOTIFY_SOCKET": "/run/x"}, pid=7).ready()


@pytest.fixture
def handed_over(tmp_path):
    """Run lines in a process with a socket from systemd; returns what it prints."""

    def run(lines, opened, names, path=""):
        script = (
            "import os, sys\n"
            "from daemon.base.process import SystemdNotifier\n"
            "os.dup2(int(sys.argv[1]), 3)\n"
            "given = {'LISTEN_PID': str(os.getpid()), 'LISTEN_FDS': '1', 'LISTEN_FDNAMES': sys.argv[2]}\n"
            "notifier = SystemdNotifier(given | {'NOTIFY_SOCKET': sys.argv[3]}, os.getpid())\n"
        )
        command = [sys.executable, "-c", script + lines, str(opened.fileno()), names, path]
        return subprocess.run(command, pass_fds=[opened.fileno()], capture_output=True, text=True, check=True).stdout

    return run


def test_a_socket_is_given_to_the_manager_with_its_name(manager):
    receiver, path = manager
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        SystemdNotifier({"NOTIFY_SOCKET": path}, pid=7).store_socket("bridge-1", port)
        said, numbers, _, _ = socket.recv_fds(receiver, 1000, 1)
        assert said == b"FDSTORE=1\nFDNAME=bridge-1"
        with socket.socket(fileno=numbers[0]) as kept:
            assert kept.getsockname() == port.getsockname()


def test_the_next_process_gets_a_kept_socket_by_its_name_and_only_once(handed_over):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        lines = (
            "print(notifier.take_stored_socket('bridge-1').getsockname()[1], notifier.take_stored_socket('bridge-1'))"
        )
        assert handed_over(lines, port, "bridge-1").split() == [str(port.getsockname()[1]), "None"]


def test_a_kept_socket_of_other_settings_is_released_before_the_port_is_taken(handed_over, manager):
    receiver, path = manager
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port, ThreadPoolExecutor(1) as threads:
        running = threads.submit(handed_over, "print(notifier.take_stored_socket('bridge-2'))", port, "bridge-1", path)
        assert receiver.recv(1000) == b"FDSTOREREMOVE=1\nFDNAME=bridge-1"
        said, numbers, _, _ = socket.recv_fds(receiver, 1000, 1)
        assert said == b"BARRIER=1"
        assert not running.done()
        for number in numbers:
            os.close(number)
        assert running.result().strip() == "None"


@pytest.mark.parametrize("environment", [{}, {"LISTEN_FDS": "1", "LISTEN_PID": "8"}, {"LISTEN_FDS": "x"}])
def test_a_socket_handed_to_another_process_is_not_taken(environment):
    assert SystemdNotifier(environment | {"LISTEN_FDNAMES": "bridge-1"}, pid=7).take_stored_socket("bridge-1") is None
