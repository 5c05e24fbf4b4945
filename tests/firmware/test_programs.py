"""The programs against the maker's firmware as a person runs them: the probe, and the whole role of a tracker."""

import contextlib
import json
import re
import time
import urllib.request

import pytest

from daemon.base.errors import ExitCode
from tests.support import PATIENCE_S, forks
from tests.support.addresses import free_port

TOKEN = "0123456789abcdef0123456789abcdef"


def heliocube(*arguments):
    return forks.run(*arguments)


def configure(firmware, folder, more=""):
    config = folder / "heliocube.toml"
    config.write_text(
        f'[instruments]\nkind = "real"\n[instruments.positioner]\nport = "{firmware.link}"\n'
        # Under load, Linux has been seen to let the pseudo-terminal wait for more than ten seconds.
        f"telemetry_stale_s = 60.0\n{more}",
        encoding="utf-8",
    )
    return config


@pytest.mark.long
def test_the_probe_identifies_compares_and_moves_both_axes_and_back(start_firmware, tmp_path):
    firmware = start_firmware(10.0, 60.0)
    before = firmware.pose_deg()
    done = heliocube("probe", "positioner", "-c", configure(firmware, tmp_path), "--seconds", "4", "--move-deg", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "board 36A1" in done.stdout
    assert "geometry of A fits" in done.stdout
    assert "agree with the configuration" in done.stdout
    assert len(re.findall(r" deg/s, stands at ", done.stdout)) == 4
    assert firmware.pose_deg() == pytest.approx(before, abs=0.3)


def test_the_probe_moves_nothing_on_a_unit_that_contradicts_the_configuration(start_firmware, tmp_path):
    firmware = start_firmware(10.0, 60.0)
    wrong = "[instruments.positioner.a_axis]\narm_1_mm = 290.0\n"
    before = firmware.positions_mm()
    done = heliocube(
        "probe", "positioner", "-c", configure(firmware, tmp_path, wrong), "--seconds", "4", "--move-deg", "2"
    )
    assert done.returncode == 2
    assert "field 72 of the positioner says 300, but instruments.positioner.a_axis.arm_1_mm is 290" in done.stdout
    assert "Traceback" not in done.stderr
    assert firmware.positions_mm() == before


@contextlib.contextmanager
def tracker(firmware, folder, for_s):
    """Run the role of a tracker on a unit; yield its configuration and the address of its interface."""
    address = f"127.0.0.1:{free_port()}"
    (folder / "token").write_text(TOKEN, encoding="utf-8")
    (folder / "token").chmod(0o600)
    more = (
        f'[api]\nlisten = "{address}"\ntoken_file = "{folder / "token"}"\n'
        '[bridge]\nlisten = "127.0.0.1:0"\ninsecure = true\n'
    )
    config = configure(firmware, folder, more)
    with (folder / "log").open("w") as log:
        service = forks.start(["run", "-c", config, "--role", "tracker", "--for", for_s], stdout=log, stderr=log)
    try:
        yield config, address
    finally:
        service.terminate()
        service.wait(PATIENCE_S)
    assert service.returncode == 0, (folder / "log").read_text(encoding="utf-8")


def state(address):
    """Return the service's state, or None while it does not answer."""
    try:
        with urllib.request.urlopen(f"http://{address}/api/state", timeout=PATIENCE_S) as reply:
            return json.load(reply)
    except OSError:
        return None


def until_state(address, condition, what):
    """Wait for a state of the service."""
    deadline_s = time.monotonic() + PATIENCE_S
    while (seen := state(address)) is None or not condition(seen):
        assert time.monotonic() < deadline_s, f"{what}: {seen and (seen['mode'], seen['tracker'])}"
        time.sleep(0.3)
    return seen


def home(config, address):
    """Order a reference run until nothing is in doubt; again, as a person would, if the unit lost the command."""
    deadline_s, again_s, shown = time.monotonic() + PATIENCE_S, 0.0, False
    while (seen := state(address)) is None or seen["tracker"]["concerns"]:
        now_s = time.monotonic()
        assert now_s < deadline_s, f"the reference run: {seen}"
        if seen is None or seen["tracker"]["homing"]:
            shown = shown or seen is not None
            # The unit ends a run before the service has judged it.
            again_s = now_s + 10.0
        elif now_s >= again_s:
            homed = heliocube("home", "-c", config)
            # Under load, an emulated unit may be silent for a minute.
            silent = "has been silent" in homed.stderr
            assert silent or homed.returncode in (ExitCode.GOOD, ExitCode.NOT_SEEN), homed.stderr
            again_s = time.monotonic() + 10.0
        time.sleep(0.3)
    assert shown, "a reference run that nobody was shown"
    return seen


def test_the_tracker_role_moves_on_the_goto_command_and_stands_after_the_stop_command(start_firmware, tmp_path):
    firmware = start_firmware()
    with tracker(firmware, tmp_path, 300) as (config, _):
        deadline_s = time.monotonic() + PATIENCE_S
        while (going := heliocube("goto", "-c", config, "--", "-20", "85")).returncode:
            assert time.monotonic() < deadline_s, going.stderr
            time.sleep(0.5)
        while abs(firmware.pose_deg()[0]) < 1.0:
            assert time.monotonic() < deadline_s, "it does not move"
            time.sleep(0.1)
        # On a busy machine the command may end before it has seen the stop; then a person asks again.
        while (stopped := heliocube("stop", "-c", config)).returncode == ExitCode.NOT_SEEN:
            assert time.monotonic() < deadline_s, stopped.stdout
        assert stopped.returncode == 0, stopped.stderr
        stands = firmware.positions_mm()
        time.sleep(2.0)
        assert firmware.positions_mm() == pytest.approx(stands, abs=0.05), "it stood when the command returned"
        assert abs(firmware.pose_deg()[0]) < 15.0


@pytest.mark.long
def test_a_lost_count_is_a_fault_until_the_tracker_role_has_homed_both_axes(start_firmware, tmp_path):
    # A way of some seconds, so that even a busy machine sees more than its end.
    firmware = start_firmware(-46.0, 20.0)
    with tracker(firmware, tmp_path, 480) as (config, address):
        until_state(address, lambda seen: seen["tracker"]["connected"], "the connection")
        # On a busy machine a command may end before it has seen its effect; this test waits for the effect.
        assert heliocube("hold", "-c", config).returncode in (ExitCode.GOOD, ExitCode.NOT_SEEN)
        # The tracker may have set out already: a jump while a stopped move runs out would count as motion.
        until_state(address, lambda seen: seen["mode"]["name"] == "hold" and not seen["tracker"]["moving"], "rest")
        time.sleep(3.0)
        # So far that even a look some seconds late shows a turn that no axis can have made.
        firmware.control("count 0 22500")
        until_state(address, lambda seen: "jumped" in (seen["tracker"]["doubt_why"] or ""), "the doubt")
        assert heliocube("auto", "-c", config).returncode == 0
        until_state(address, lambda seen: seen["mode"]["name"] == "fault", "the fault")
        seen = home(config, address)
        assert "reference" not in [alarm["name"] for alarm in seen["alarms"]]
        assert seen["mode"]["name"] != "fault"
        assert heliocube("hold", "-c", config).returncode in (ExitCode.GOOD, ExitCode.NOT_SEEN)
        shown = until_state(address, lambda seen: not seen["tracker"]["moving"], "rest again")["tracker"]["pose"]
        assert firmware.pose_deg() == pytest.approx((shown["a_deg"], shown["b_deg"]), abs=0.5)
