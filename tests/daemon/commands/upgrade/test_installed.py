"""The way back of an installation: in one command, with the units that ran, whatever interrupts it."""

import contextlib
import gc
import json
import os
import signal
import sys

import pytest

from daemon.store.schema import VERSION
from tests.daemon.commands.upgrade.test_rollback import config, program
from tests.support.leaks import children

__all__ = ["config", "program"]


@pytest.fixture
def installation(program, tmp_path, monkeypatch):
    """Two releases, the newer of which runs this, and a service manager with one unit that runs and one that cannot."""
    releases = tmp_path / "opt" / "releases"
    for name in ("older", "newer", "half"):
        program(VERSION, prefix=releases / name)
    # An installation that was interrupted is not a release to go back to.
    (releases / "half" / ".complete").unlink()
    (releases.parent / "current").symlink_to("releases/newer")
    monkeypatch.setattr(sys, "prefix", str(releases / "newer"))
    monkeypatch.setattr("os.geteuid", lambda: 0)

    manager = tmp_path / "path" / "systemctl"
    manager.parent.mkdir()
    states = "heliocube-tracker) echo active ;; heliocube-cube) echo failed ;; *) echo inactive ;;"
    answers = f'[ "$1" != is-active ] || case $2 in {states} esac'
    manager.write_text(f'#!/bin/sh\necho "$*" >>{tmp_path}/asked\n{answers}\n')
    manager.chmod(0o755)
    monkeypatch.setenv("PATH", f"{manager.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr("daemon.commands.upgrade.installed._SYSTEMD", tmp_path)
    return releases


def test_rollback_switches_to_the_older_release_and_starts_the_units_that_ran(
    heliocube, config, installation, tmp_path
):
    code, out, err = heliocube("rollback", "--json", "-c", config)
    assert code == 0
    assert err.splitlines()[-1] == "older is in use: look at the tracker, then release it as 'heliocube status' says"
    page = json.loads(out)
    assert (page["release"], page["in_use"], page["not_started"]) == ("older", True, [])
    assert page["done"] == err.splitlines()[:-1]
    assert (installation.parent / "current").resolve() == installation / "older"
    asked = [line for line in (tmp_path / "asked").read_text().splitlines() if not line.startswith("is-active")]
    assert asked == [
        "stop heliocube-tracker",
        "stop heliocube-cube",
        "reset-failed heliocube-tracker heliocube-cube",
        "start --no-block heliocube-tracker heliocube-cube",
        "start heliocube-tracker",
        "start heliocube-cube",
    ]


def test_a_second_rollback_is_refused_and_does_not_go_forward_to_the_newer_release(
    heliocube, config, installation, tmp_path, monkeypatch
):
    manager = tmp_path / "path" / "systemctl"
    manager.write_text(f'{manager.read_text()}[ "$*" != "start heliocube-cube" ]\n')
    code, out, _ = heliocube("rollback", "-c", config)
    assert code == 3
    before_the_start = out.splitlines()[-3]
    assert before_the_start == "older is in use; starting heliocube-tracker, heliocube-cube"
    assert "heliocube-cube does not start" in out.splitlines()[-2]

    # From now on the command belongs to the release in use.
    monkeypatch.setattr(sys, "prefix", str(installation / "older"))
    (tmp_path / "asked").unlink()
    code, _, err = heliocube("rollback", "-c", config)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "has no release before older, which is in use: start the units that do not run" in err
    assert (installation.parent / "current").resolve() == installation / "older"
    assert not (tmp_path / "asked").exists(), "nothing is stopped"


def test_units_that_ran_are_started_again_when_a_rollback_fails(heliocube, config, installation, tmp_path):
    config.write_text("[site]\nlatitude_deg = 95\n")
    code, _, err = heliocube("rollback", "-c", config)
    assert code == 2
    assert "latitude_deg" in err
    assert (installation.parent / "current").resolve() == installation / "newer"
    assert "start heliocube-tracker" in (tmp_path / "asked").read_text().splitlines()


def test_when_a_unit_does_not_stop_the_rollback_fails_and_all_units_that_ran_are_started_again(
    heliocube, config, installation, tmp_path
):
    manager = tmp_path / "path" / "systemctl"
    manager.write_text(f'{manager.read_text()}[ "$*" != "stop heliocube-cube" ]\n')
    code, _, err = heliocube("rollback", "-c", config)
    assert code == 2
    assert "heliocube-cube does not stop" in err
    # The unit may only have been late, and may have stopped by now.
    asked = (tmp_path / "asked").read_text().splitlines()
    assert asked[-2:] == ["start heliocube-tracker", "start heliocube-cube"]
    assert (installation.parent / "current").resolve() == installation / "newer"


# When a call of systemctl is interrupted, its process is left to end by itself.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_all_units_that_ran_are_started_although_sigint_interrupts_the_start_of_the_first(
    heliocube, config, installation, tmp_path
):
    manager = tmp_path / "path" / "systemctl"
    manager.write_text(f'{manager.read_text()}[ "$*" != "start heliocube-tracker" ] || kill -INT $PPID\n')
    code, _, err = heliocube("rollback", "-c", config)
    gc.collect()
    for systemctl in children():
        with contextlib.suppress(ChildProcessError):
            os.waitpid(systemctl, 0)
    assert code == 130
    # A second rollback would find no release before this one.
    then = "look at the tracker, then release it as 'heliocube status' says"
    told = f"units that ran are started again, and older is in use: {then}"
    assert err == f"heliocube: interrupted: {told}\n"
    started = [line for line in (tmp_path / "asked").read_text().splitlines() if line.startswith("start ")]
    assert "heliocube-cube" in " ".join(started)
    assert (installation.parent / "current").resolve() == installation / "older"


# When a call of systemctl is interrupted, its process is left to end by itself.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("by", ["INT", "HUP", "TERM"])
def test_units_that_ran_are_started_again_when_a_signal_interrupts_a_rollback(
    heliocube, config, installation, tmp_path, by
):
    manager = tmp_path / "path" / "systemctl"
    manager.write_text(f'{manager.read_text()}[ "$*" != "stop heliocube-cube" ] || kill -{by} $PPID\n')
    missed = []
    handlers = {name: signal.signal(name, lambda *_: missed.append("ends")) for name in (signal.SIGHUP, signal.SIGTERM)}
    try:
        code, out, err = heliocube("rollback", "-c", config)
        assert signal.getsignal(signal.SIGHUP) is not signal.default_int_handler
    finally:
        for name, handler in handlers.items():
            signal.signal(name, handler)
        gc.collect()
        for systemctl in children():
            with contextlib.suppress(ChildProcessError):
                os.waitpid(systemctl, 0)
    assert (code, out, missed) == (130, "", [])
    assert err.startswith("heliocube: interrupted: units that ran are started again; give the command again, and it")
    asked = (tmp_path / "asked").read_text().splitlines()
    assert asked[-2:] == ["start heliocube-tracker", "start heliocube-cube"]
    assert (installation.parent / "current").resolve() == installation / "newer"
