import asyncio
import ipaddress
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import tomllib
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus
from daemon.base.timeloop import VirtualTimeLoop
from daemon.bridge.signing import generate_key, write_key
from daemon.commands.file_check import check_file
from daemon.config.file import load_settings
from daemon.config.migrate import migrate
from daemon.config.settings import Settings
from daemon.config.simulation import DEFAULT_START
from daemon.rigs.simulated import build_simulated_rig, build_weather
from daemon.service.rig import Role
from daemon.service.service import Service
from tests.system.conftest import ROOT

DEPLOY = ROOT / "deploy"
EXAMPLES = DEPLOY / "examples"
ROLES = ("cube", "tracker")
CONFIGURED = (*ROLES, "dashboard", "notify", "archive")
UNITS = (*CONFIGURED, "report", "parquet")
TIMERS = {"report": "03:15:00", "parquet": "01:40:00"}
STARTS = {
    **{role: f"run --role {role} --config /etc/heliocube/{role}.toml" for role in ROLES},
    "dashboard": "dashboard --config %d/dashboard.toml",
    "report": "report --config /etc/heliocube/tracker.toml --day yesterday --out /var/lib/heliocube/reports --force",
    "notify": "notify --config %d/notify.toml",
    "archive": "archive --config %d/archive.toml",
    "parquet": "archive parquet --config %d/archive.toml --out /var/lib/heliocube-parquet",
}
LIGHT = {
    *("annotated-doc", "annotated-types", "click", "markdown-it-py", "mdurl", "numpy", "psycopg", "psycopg-binary"),
    *("pydantic", "pydantic-core", "pygments", "pyjwt", "rich", "shellingham", "tomli-w", "typer", "typing-extensions"),
    "typing-inspection",
}
pytestmark = pytest.mark.system
needs_analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def run(*command, **options):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, **options)


# The units


def stand_in(tmp_path, role, change=lambda text: text):
    """The unit, with a program that exists here in place of the installed one."""
    installed = "/opt/heliocube/current/bin/heliocube"
    text = (DEPLOY / f"heliocube-{role}.service").read_text()
    assert f"ExecStart={installed} {STARTS[role]}\n" in text
    unit = tmp_path / f"heliocube-{role}.service"
    unit.write_text(change(text.replace(installed, "/bin/true")))
    return unit


@needs_analyze
@pytest.mark.parametrize("role", UNITS)
def test_systemd_accepts_every_line_of_the_units(tmp_path, role):
    done = run("systemd-analyze", "verify", stand_in(tmp_path, role))
    assert (done.returncode, done.stderr) == (0, "")


@needs_analyze
@pytest.mark.parametrize("name", TIMERS)
def test_systemd_accepts_the_timers_and_their_calendar_times(tmp_path, name):
    timer = tmp_path / f"heliocube-{name}.timer"
    shutil.copy(DEPLOY / timer.name, timer)
    stand_in(tmp_path, name)
    done = run("systemd-analyze", "verify", timer)
    assert (done.returncode, done.stderr) == (0, "")
    when = re.search(r"^OnCalendar=(.*)$", timer.read_text(), re.MULTILINE)[1]
    assert TIMERS[name] in run("systemd-analyze", "calendar", when).stdout


@needs_analyze
def test_systemd_analyze_reports_a_misspelt_line_of_a_unit(tmp_path):
    unit = stand_in(tmp_path, "cube", lambda text: text.replace("WatchdogSec=", "WatchdogSecs="))
    assert "WatchdogSecs" in run("systemd-analyze", "verify", unit).stderr


@needs_analyze
@pytest.mark.parametrize("role", UNITS)
def test_the_exposure_of_each_unit_by_systemd_analyze_is_at_most_1_5(tmp_path, role):
    done = run("systemd-analyze", "security", "--offline=true", "--threshold=15", stand_in(tmp_path, role))
    assert done.returncode == 0, done.stdout
    exposure = float(re.search(r"exposure level.*: ([\d.]+)", done.stdout)[1])
    assert exposure <= 1.5


@pytest.mark.parametrize("role", [name for name in UNITS if name != "notify"])
def test_a_unit_reaches_private_networks_and_nothing_beyond_them(role):
    unit = (DEPLOY / f"heliocube-{role}.service").read_text()
    allowed = " ".join(re.findall(r"^IPAddressAllow=(.*)$", unit, re.MULTILINE)).split()
    named = {"localhost", "link-local", "multicast"}
    assert "\nIPAddressDeny=any\n" in unit
    assert all(entry in named or ipaddress.ip_network(entry).is_private for entry in allowed)
    assert bool(allowed) != ("\nPrivateNetwork=yes\n" in unit)


@pytest.mark.parametrize("role", ROLES)
def test_the_units_do_not_wait_for_a_network_at_start_and_restart_without_limit(role):
    unit = (DEPLOY / f"heliocube-{role}.service").read_text().splitlines()
    waited = [line for line in unit if line.startswith(("Wants=", "After=", "Requires=")) and "network-online" in line]
    assert not waited
    assert {"Restart=always", "RestartSec=5", "StartLimitIntervalSec=0"} <= {*unit}


@pytest.mark.parametrize("role", ROLES)
def test_a_unit_allows_a_device_class_only_if_its_kernel_module_is_loaded(role):
    unit = (DEPLOY / f"heliocube-{role}.service").read_text()
    modules = (DEPLOY / "heliocube.modules-load.conf").read_text().split("\n")
    module_of = {"char-ttyACM": "cdc_acm", "char-ttyUSB": "usbserial", "char-usb_device": None}
    for allowed in re.findall(r"^DeviceAllow=(\S+)", unit, re.MULTILINE):
        module = module_of[allowed]
        assert module is None or (module in modules and f"modprobe@{module}.service" in unit)


# The device rules


def rules():
    text = (DEPLOY / "heliocube.rules").read_text()
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_every_udev_rule_is_well_formed_and_every_goto_has_its_label():
    term = re.compile(r'\s*[A-Z]+(\{[\w/]+\})?\s*(==|!=|=|\+=|-=|:=)\s*"[^"]*"\s*')
    for line in rules():
        assert all(term.fullmatch(part) for part in re.split(r",(?=\s*[A-Z])", line)), line
    gotos = {name for line in rules() for name in re.findall(r'GOTO="(\w+)"', line)}
    labels = {name for line in rules() for name in re.findall(r'LABEL="(\w+)"', line)}
    assert gotos == labels


def test_the_udev_rules_give_the_positioner_a_name_a_group_and_a_port_without_echo():
    text = "\n".join(rules())
    for part in ('SYMLINK+="heliocube-positioner"', 'GROUP="heliocube"', 'MODE="0660"', 'ENV{ID_MM_DEVICE_IGNORE}="1"'):
        assert part in text
    raw = next(line for line in rules() if "stty" in line)
    assert 'ACTION=="add"' in raw
    assert " raw -echo " in raw


def test_the_stty_settings_in_the_udev_rules_turn_off_the_echo():
    stty = re.search(r'RUN\+="/usr/bin/(stty) -F \$devnode ([^"]*)"', "\n".join(rules()))
    controller, terminal = os.openpty()
    try:
        done = run(stty[1], "-F", os.ttyname(terminal), *stty[2].split())
        assert (done.returncode, done.stderr) == (0, "")
        os.write(controller, b"$,12.3$-45.6")
        os.set_blocking(controller, False)
        with pytest.raises(BlockingIOError):
            os.read(controller, 100)
    finally:
        os.close(controller)
        os.close(terminal)


# The examples


@pytest.mark.parametrize("name", ["both", *CONFIGURED])
def test_the_example_configurations_pass_the_check_and_are_up_to_date(tmp_path, name):
    shutil.copy(EXAMPLES / f"{name}.toml", tmp_path)
    write_key(tmp_path / "bridge.key", generate_key())
    (tmp_path / "api.token").write_text("t" * 40)
    (tmp_path / "api.token").chmod(0o600)
    (tmp_path / "notify.people").write_text("ntfy://ntfy.lab/roof\n")
    (tmp_path / "notify.people").chmod(0o600)
    (tmp_path / "archive.credentials").write_text("user:password\n")
    (tmp_path / "archive.credentials").chmod(0o600)
    assert check_file(tmp_path / f"{name}.toml").instruments.kind == "simulated"
    assert migrate(tmp_path / f"{name}.toml", keys_only=True).endswith("is up to date: nothing was changed")


def test_the_examples_of_cube_and_tracker_fit_together_on_one_machine():
    cube, tracker = (load_settings(EXAMPLES / f"{role}.toml") for role in ROLES)
    assert tracker.bridge.listen in cube.bridge.send_to
    assert tracker.bridge.key_file == cube.bridge.key_file
    assert tracker.cube.name == cube.cube.name
    assert tracker.cube.scan_every_s == cube.cube.scan_every_s
    assert tracker.api.listen != cube.api.listen
    assert tracker.store.directory != cube.store.directory


# The service under a service manager


def test_both_roles_start_answer_the_watchdog_and_stop(start_unit):
    units = {role: start_unit(role, watchdog_s=4.0) for role in ROLES}
    for unit in units.values():
        unit.wait_for("READY=1", 60)
    for role, unit in units.items():
        unit.messages.clear()
        for _ in range(2):
            unit.wait_for("WATCHDOG=1", 60)
        status, _ = unit.wait_for("STATUS=", 60)
        assert status.removeprefix("STATUS="), role
        assert unit.end(signal.SIGTERM) == 0, unit.log.read_text()
        unit.wait_for("STOPPING=1", 20)
        assert "Traceback" not in unit.log.read_text()


@pytest.mark.parametrize("role", ROLES)
def test_a_frozen_process_does_not_answer_the_watchdog(start_unit, role):
    unit = start_unit(role, watchdog_s=1.0)
    unit.wait_for("WATCHDOG=1", 60)
    unit.process.send_signal(signal.SIGSTOP)
    unit.listen(0.2)
    assert unit.listen(2.0, until="WATCHDOG=1") is None
    assert unit.end(signal.SIGABRT) == -signal.SIGABRT, "the service manager's next step ends it"


@pytest.mark.parametrize(("part", "words"), [("control", "control has not run"), ("acquisition", "no scan has")])
def test_a_stalled_control_or_acquisition_leaves_the_watchdog_unanswered_though_the_loop_runs(tmp_path, part, words):
    messages = []

    async def scenario(receiver):
        loop = asyncio.get_running_loop()
        settings = Settings.model_validate({"bridge": {"listen": "127.0.0.1:0", "send_to": ()}})
        clock = LoopClock(loop.time, DEFAULT_START.timestamp())
        weather, _ = build_weather(settings, clock.utc(), clock.utc() + 3600)
        notifier = SystemdNotifier({"NOTIFY_SOCKET": receiver.getsockname(), "WATCHDOG_USEC": "10000000"}, os.getpid())
        rig = build_simulated_rig(settings, Role.BOTH, clock, weather)
        service = Service(settings, Role.BOTH, rig, clock, Random(1), Bus(), generate_key(), notifier)
        stop = asyncio.Event()
        serving = asyncio.create_task(service.run(stop))

        async def pass_time(for_s):
            for _ in range(for_s):
                await asyncio.sleep(1)
                messages.extend(received(receiver))

        await pass_time(60)
        assert messages.count("WATCHDOG=1") >= 10
        next(task for task in asyncio.all_tasks() if task.get_name() == part).cancel()
        await pass_time(60)
        messages.clear()
        await pass_time(60)
        stop.set()
        await serving

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.setblocking(False)
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            runner.run(scenario(receiver))
    assert "WATCHDOG=1" not in messages
    assert all(words in message for message in messages)
    assert messages


def received(receiver):
    while True:
        try:
            yield receiver.recv(4096).decode()
        except BlockingIOError:
            return


# The installation


def files_in(tree, but=()):
    found = (path for path in tree.rglob("*") if path.is_file() or path.is_symlink())
    names = {str(path.relative_to(tree)) for path in found}
    return {name for name in names if not name.startswith(but)}


def pinned(lock):
    return re.split(r"\n(?=\S)", lock.strip())


def lighten(lock):
    """Keep in a lock only what the check of a configuration imports, and the requirements of that."""
    kept = [one for one in pinned(lock.read_text()) if re.match(r"[\w.-]+", one)[0] in LIGHT]
    lock.write_text("\n".join(kept) + "\n")


@pytest.mark.skipif(os.geteuid() != 0, reason="installing needs root")
@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="systemd-sysusers is not installed")
@pytest.mark.long
def test_installing_twice_and_removing_leaves_only_data_and_configuration(tmp_path, checkout, monkeypatch):
    # pip would spend most of its time on compiling the libraries, which nothing here needs.
    monkeypatch.setenv("PIP_COMPILE", "0")
    # Nor does it unpack the libraries that are not used here; deploy/test-boot installs all that is locked.
    for name in ("runtime", "archive"):
        lighten(checkout / "deploy" / "lock" / f"{name}.txt")
    tree = tmp_path / "tree"
    tree.mkdir()
    install = ("sh", checkout / "deploy" / "install.sh", "--root", tree)

    alone = run(*install, "--role", "archive")
    assert alone.returncode == 0, alone.stderr
    assert "systemctl enable --now heliocube-archive" in alone.stdout
    units = tree / "etc/systemd/system"
    archive_units = {f"heliocube-{name}" for name in ("archive.service", "parquet.service", "parquet.timer")}
    assert archive_units <= {path.name for path in units.iterdir()}
    assert not (units / "heliocube-tracker.service").exists()
    assert not list(units.glob("*.wants")), "nothing is enabled"

    first = run(*install, "--role", "both")
    assert first.returncode == 0, first.stderr
    assert "building" not in first.stdout, "who has been an archive stays one"
    assert "systemctl enable --now heliocube-tracker" in first.stdout
    program = tree / "opt/heliocube/current/bin/heliocube"
    assert run(program, "--version").stdout.startswith("heliocube ")
    assert run(program.parent / "python", "-c", "import psycopg").returncode == 0
    # Without notify.toml: the check refuses it as long as no file names the people to tell.
    for role in (*ROLES, "dashboard"):
        checked = run(program, "config", "check", tree / f"etc/heliocube/{role}.toml")
        assert checked.returncode == 0, checked.stderr
    key = tree / "etc/heliocube/bridge.key"
    passwd = (tree / "etc/passwd").read_text()
    uid = int(re.search(r"^heliocube:x:(\d+):", passwd, re.MULTILINE)[1])
    assert (key.stat().st_uid, stat.S_IMODE(key.stat().st_mode)) == (uid, 0o600)
    assert (tree / "var/lib/heliocube").stat().st_uid == uid
    assert stat.S_IMODE((tree / "etc/heliocube/api.token").stat().st_mode) == 0o640

    mine = tree / "etc/heliocube/tracker.toml"
    mine.write_text('# mine\n[law]\nname = "flat"\n')
    (tree / "var/lib/heliocube/records.sqlite").write_text("data")
    secret = key.read_text()
    second = run(*install)
    assert second.returncode == 0, second.stderr
    assert "building" not in second.stdout, "an environment that is complete is not built again"
    assert mine.read_text() == '# mine\n[law]\ndriver = "flat"\n', "a key that has another name now gets it"
    (older,) = mine.parent.glob("*.before-*")
    assert older.read_text() == '# mine\n[law]\nname = "flat"\n'
    assert key.read_text() == secret

    removed = run(*install, "--remove")
    assert removed.returncode == 0, removed.stderr
    assert files_in(tree, but=("etc/passwd", "etc/group", "etc/shadow", "etc/gshadow", "etc/.pwd.lock")) == {
        "etc/heliocube/api.token",
        "etc/heliocube/archive.toml",
        "etc/heliocube/bridge.key",
        "etc/heliocube/cube.toml",
        "etc/heliocube/dashboard.toml",
        "etc/heliocube/notify.toml",
        "etc/heliocube/tracker.toml",
        f"etc/heliocube/{older.name}",
        "var/lib/heliocube/records.sqlite",
    }
    assert run(*install, "--remove").returncode == 0, "removing twice is no error"


def test_the_installation_fetches_nothing_that_the_lock_files_do_not_pin_by_hash():
    """pip reaches an index only where it asks for hashes, and builds only with what is there."""
    text = (DEPLOY / "install.sh").read_text().replace("\\\n", " ")
    calls = [line for line in text.splitlines() if re.search(r"\bpip install | -m pip .* wheel ", line)]
    assert len(calls) == 4
    for line in calls:
        assert ("--require-hashes" in line and "--only-binary :all:" in line) != ("--no-index" in line), line
        assert (" wheel " in line) == ("--no-build-isolation" in line), line
    for name in ("runtime", "notify", "archive", "build"):
        lock = (DEPLOY / "lock" / f"{name}.txt").read_text()
        assert all(re.match(r"[\w.-]+(\[\w,]+\])?==\S+", one) and "--hash=sha256:" in one for one in pinned(lock))
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert all(re.search(rf"^{re.match(r'[a-z]+', one)[0]}==", lock, re.MULTILINE) for one in wanted)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--role", "sun"], "--role sun: must be cube, tracker, both or archive"),
        (["--role"], "--role needs a value"),
        (["--root", "", "--role", "sun"], "--root needs a value"),
        (["--frm", "x"], "'--frm' is no option"),
        (["--root", "/nowhere/at/all"], "--root /nowhere/at/all: there is no such folder"),
        (["--from", "gone.whl"], "--from gone.whl: there is no such wheel"),
        (["--from", "/"], "--from /: neither a heliocube wheel nor a checkout"),
        (["--python", "python9"], "there is no python9: apt-get install python3 python3-venv"),
    ],
)
@pytest.mark.skipif(os.geteuid() != 0, reason="installing needs root")
def test_a_mistaken_option_of_install_sh_is_refused_in_one_sentence_and_changes_nothing(tmp_path, arguments, sentence):
    root = [] if "--root" in arguments else ["--root", tmp_path]
    done = run("sh", DEPLOY / "install.sh", *root, *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
