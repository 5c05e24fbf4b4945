"""Every command in a shell block of README and docs: run as printed where that can be, else checked or named here.

A command that moves real hardware, needs root or another machine, or takes long is not run; each such one is named
below with the reason, and a reason that no command needs any more fails.
"""

import gzip
import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from daemon.commands.main import app, main
from daemon.studies.samples import DAYS, sample
from tests.support import DOCS, ROOT
from tests.support.addresses import free_port
from tests.support.stored_day import stored_days
from tests.system.processes import Process, wait_until

pytestmark = pytest.mark.slow

PAGES = [
    *(ROOT / "README.md", ROOT / "CONTRIBUTING.md"),
    *sorted(page for page in DOCS.rglob("*.md") if page.parent.name != "decisions"),
]
BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)

# Why commands are not run, by their beginning.
LEFT_OUT = {
    "sudo": "asks for root; tests/system/test_deploy.py installs into a folder of its own",
    "sudoedit": "asks for root, and for a person",
    "git clone": "asks for the network, and for the address of the repository",
    "tail -n 1 /etc/heliocube/bridge.key | ssh": "asks for another machine",
    "ufw": "changes the firewall",
    "netsh": "changes the firewall, on Windows",
    "ls -l /dev": "asks for the positioner",
    "python -m venv analysis": "asks for the network",
    "mosquitto_": "asks for a broker; tests/daemon/mqtt sends these orders to one",
    "mbpoll": "asks for a service with SunSpec; tests/system/test_sunspec.py runs mbpoll on one",
    "rotctl": "asks for Hamlib; tests/system/test_rotator_on_bench.py runs it",
    "python -m tests.campaign.real": "takes minutes",
    "python tests/measurements/": "takes minutes, on a machine that does nothing else",
    ".venv/bin/python -m tests.fuzz.run positioner-screens": "takes an hour",
    ".venv/bin/python -m tests.mutation": "takes hours",
    ".venv/bin/python -m pytest": "is this suite",
    "curl": "asks for a service at work; tests/daemon/api sends these orders to one",
}
# The options of these commands are read as the program reads them; what they do is tested elsewhere.
ONLY_READ = {
    "heliocube alarms": "an alarm has to be on",
    "heliocube archive": "asks for a database and a broker; tests/daemon/archive has both",
    "heliocube report --store 'postgresql": "asks for an archive; tests/daemon/commands/archive reads one",
    "heliocube export --store 'postgresql": "likewise",
    "heliocube compare report --store 'postgresql": "likewise",
    "heliocube bench --": "tests/system/test_bench.py",
    "heliocube campaign": "takes long; tests/daemon/studies/campaign and tests/campaign",
    "heliocube dashboard": "tests/system/test_dashboard.py",
    "heliocube hold": "tests/system/test_operation.py",
    "heliocube probe": "tests/system/test_probe.py",
    "heliocube setup": "asks a person; tests/system/test_setup.py answers it",
    "heliocube run": "the tutorials run it; so does tests/system/test_run.py",
    "heliocube status": "the tutorials run it; so does tests/system/test_operation.py",
}
# These pages run the service, and all their commands are run on it.
WITH_A_SERVICE = ("first-hour.md", "day-at-the-rig.md")
SHELL = ("openssl", "promtool", ".venv/bin/python -m tests.fuzz.run --list")
# Changes that keep a command in a folder of its own, and short.
CHANGES = (
    (r"^\.venv/bin/heliocube", "heliocube"),
    (r"~/", "home/"),
    (r"(?<![\w.])/tmp/", "tmp/"),
    (r"/var/lib/heliocube/tracker", "records"),
    (r"/etc/heliocube/", ""),
    (r"^(heliocube replay )tmp/samples/mixed.csv", r"\1faces.csv"),
    (r"--day yesterday", "--day 2022-10-14"),
    (r"^(heliocube (?:compare )?simulate .*--start \S+)", r"\1T11:00Z --days 0.01"),
    (r"(--plot map|--lat-range 0:65):1", r"\1:13"),
)
# Exit codes beside 0 that a command may end with.
REFUSED = {"heliocube goto 0 60": 6, "heliocube status --check": 4}


def commands(page):
    """Yield each command of a page's shell blocks, without its prompt, its comment and what it answers."""
    for _, language, body in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language not in {"sh", "console"}:
            continue
        lines = [line.strip() for line in body.splitlines()]
        if language == "console":
            lines = [found[1] for line in lines if (found := re.match(r"\w*\$ +(.*)", line))]
        for line in re.sub(r"&&\n", "&& ", "\n".join(lines)).splitlines():
            for part in re.sub(r"\s+#.*", "", line).split("; heliocube "):
                yield part if part == line or not line.partition("; ")[2].endswith(part) else f"heliocube {part}"


ALL = {page: list(commands(page)) for page in PAGES}
EVERY = [command for listed in ALL.values() for command in listed]


def begins(command, table):
    return next((start for start in table if command.startswith(start)), None)


def changed(command):
    for pattern, other in CHANGES:
        command = re.sub(pattern, other, command)
    return command


def two_hours(name):
    return minutes(name, 660, 780)


def minutes(name, begin, end):
    header, *rows = sample(name).read_text().splitlines(keepends=True)
    return header + "".join(rows[begin:end])


def printed_file(page, beginning):
    """Return the file that a page prints for its reader."""
    blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
    (found,) = (body for _, _, body in blocks if body.startswith(beginning))
    return found


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """What the pages presume: a configuration, a store, recordings and weather, in a folder."""
    folder = tmp_path_factory.mktemp("prepared")
    (folder / "samples").mkdir()
    for name in DAYS:
        shutil.copy(sample(name), folder / "samples")
    (folder / "faces.csv").write_text(two_hours("mixed"))
    (folder / "weather.csv").write_text(two_hours("clear"))
    (folder / "weather").mkdir()
    for month in ("2015-10", "2016-10"):
        (folder / "weather" / f"{month}.csv.gz").write_bytes(gzip.compress(minutes("clear", 690, 720).encode()))
    (folder / "points.csv").write_text(printed_file("theory.md", "phi_deg,"))
    stored_days(folder / "records")
    (folder / "heliocube.toml").write_text('[store]\ndirectory = "records"\n')
    return folder


@pytest.fixture
def folder(prepared, tmp_path, monkeypatch):
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HELIOCUBE_CONFIG", raising=False)
    return tmp_path


@pytest.fixture
def heliocube(monkeypatch, capsys):
    """Run the program in this process; returns its exit code and what it wrote."""

    def run(words):
        monkeypatch.setattr(sys, "argv", ["heliocube", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        written = capsys.readouterr()
        return ended.value.code or 0, written.out + written.err

    return run


def words_of(command):
    """Return the arguments that a shell would give the program: without a pipe, with files in place of wildcards."""
    words = shlex.split(re.split(r" [|&]|2>", command)[0])[1:]
    found = [sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in words]
    return [word for several in found for word in several]


def read(command):
    """Read a command's words as the program does, without doing anything."""
    leaf, words = get_command(app), shlex.split(re.split(r" [|&]|2>", command)[0])[1:]
    while words and words[0] in getattr(leaf, "commands", {}):
        leaf = leaf.commands[words.pop(0)]
    leaf.make_context("heliocube", words)


def dry_run(command):
    subprocess.run(["make", "-n", *shlex.split(command)[1:]], cwd=ROOT, check=True, capture_output=True)
    options = re.match(r'make run ARGS="(.*)"', command)
    if options:
        read(f"heliocube run {options[1]}")


def is_run(command):
    return not begins(command, LEFT_OUT) and not begins(command, ONLY_READ)


def try_out(command, heliocube):
    """Do what the command says, as far as this test may."""
    if begins(command, LEFT_OUT):
        return
    if command.startswith("make "):
        dry_run(command)
    elif begins(command, SHELL):
        if shutil.which(command.split()[0]) or command.startswith("."):
            text = changed(command).replace(".venv/bin/python", sys.executable)
            here = ROOT if "tests." in text or "deploy/" in text else None
            subprocess.run(text, shell=True, check=True, capture_output=True, cwd=here)
    elif begins(command, ONLY_READ):
        read(command)
    elif command.startswith("export "):
        assert re.fullmatch(r"export( \w+=\S+)+", command)
    else:
        changed_to = changed(command)
        assert changed_to.startswith("heliocube "), f"neither run nor named with a reason: {command}"
        code, output = heliocube(words_of(changed_to))
        assert code == 0, output
        # The tests' substitute weather is not from the page's site; the samples are, if the page names it rightly.
        assert "does not fit a site" not in output or "samples/" not in command, output


@pytest.mark.parametrize(
    "page",
    [page for page, listed in ALL.items() if listed and page.name not in WITH_A_SERVICE],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_the_shell_commands_of_a_page_work_as_printed(page, folder, heliocube):
    for command in ALL[page]:
        try_out(command, heliocube)


def on_free_ports(config):
    """Let the service of a configuration take ports that nobody has."""
    text = config.read_text()
    for port, kind in ((20571, socket.SOCK_DGRAM), (20572, socket.SOCK_STREAM)):
        text = text.replace(f"127.0.0.1:{port}", f"127.0.0.1:{free_port(kind)}")
    config.write_text(re.sub(r"^#(listen = .*)", r"\1", text, flags=re.MULTILINE))


@pytest.fixture(scope="module")
def readers_folder(tmp_path_factory):
    """The folder in which a reader follows one tutorial after the other."""
    return tmp_path_factory.mktemp("reader")


@pytest.mark.live
@pytest.mark.parametrize("name", WITH_A_SERVICE)
def test_a_tutorial_runs_from_its_first_command_to_its_last(name, readers_folder, heliocube, monkeypatch):
    monkeypatch.chdir(readers_folder)
    monkeypatch.delenv("HELIOCUBE_CONFIG", raising=False)
    (page,) = (page for page in ALL if page.name == name)
    service = None
    try:
        for command in ALL[page]:
            if command.startswith("heliocube run "):
                config = re.search(r"--config (\S+)", command)[1]
                on_free_ports(Path(config))
                monkeypatch.setenv("HELIOCUBE_CONFIG", config)
                service = Process(words_of(command), readers_folder / f"{name}.log")
                wait_until(lambda: "tracking" in heliocube(["status", "--check"])[1], service.log)
            elif command.startswith(("make ", "export ")):
                try_out(command, heliocube)
            elif command.startswith(("heliocube export", "heliocube report")):
                # Records are written some seconds after the events that they tell of.
                wait_until(lambda line=command: heliocube(words_of(line))[0] == 0, command)
            else:
                code, output = heliocube(words_of(changed(command)))
                assert code in {0, REFUSED.get(command)}, f"{command}: {output}"
    finally:
        if service is not None:
            service.ask_to_stop()
            service.wait()
    assert service.exit_code == 0


def test_every_reason_for_not_running_a_command_still_applies_to_some_command():
    for table in (LEFT_OUT, ONLY_READ):
        assert [start for start in table if not any(command.startswith(start) for command in EVERY)] == []


def test_pages_have_commands_only_in_sh_and_console_blocks():
    for page in PAGES:
        for _, language, body in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language not in {"sh", "console"}:
                assert not re.search(r"^ *(\$ |heliocube [a-z]+ -|sudo |make \w+$)", body, re.MULTILINE), (
                    f"{page}: {body}"
                )


def test_an_unknown_option_in_a_printed_command_is_detected():
    with pytest.raises(Exception, match="No such option"):
        read("heliocube simulate --start 2022-10-14 --colour red --out x")
