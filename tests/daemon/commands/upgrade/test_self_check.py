"""What `heliocube self-check` says of a healthy rig, and of each thing that is wrong."""

import asyncio
import json
import re
import sqlite3
from contextlib import closing

import pytest

from daemon.base.installation import release
from daemon.base.records import Mode
from daemon.commands.upgrade.running import check_running_release, service_findings
from daemon.config.settings import Settings
from daemon.store.schema import FILE_NAME, VERSION, open_for_writing
from tests.daemon.store.test_full_disk import small_disk
from tests.support.api import serve

__all__ = ["serve", "small_disk"]

STALE_S = 60.0


@pytest.fixture
def config(tmp_path):
    """A file of a simulated rig, whose service has no interface."""
    file = tmp_path / "heliocube.toml"
    file.write_text("[api]\nenabled = false\n[store]\ndirectory = 'records'\n[bridge]\ninsecure = true\n")
    return file


def by_subject(out):
    return {each["subject"]: each for each in json.loads(out)["findings"]}


def texts(findings):
    return {each.subject: each.text for each in findings}


def amiss(findings):
    return {each.subject: each for each in findings if not each.ok}


def test_the_self_check_of_a_healthy_rig_has_one_ok_line_per_subject_and_exit_code_0(heliocube, config):
    code, out, err = heliocube("self-check", "-c", config)
    assert (code, err) == (0, "")
    assert [line.split()[:2] for line in out.splitlines()] == [
        *(["ok", name] for name in ("program", "configuration", "store", "disk", "clock", "instruments", "wind")),
        ["all", "is"],
    ]
    assert not (config.parent / "records").exists()


def test_the_self_check_has_exit_code_2_for_an_invalid_configuration_and_for_none(heliocube, config):
    config.write_text("[site]\nlatitude_deg = 95\n")
    code, out, err = heliocube("self-check", "--json", "-c", config)
    assert (code, err) == (2, "")
    assert json.loads(out)["exit_code"] == 2
    assert "latitude_deg = 95" in by_subject(out)["configuration"]["text"]

    code, out, err = heliocube("self-check")
    assert (code, out, len(err.splitlines())) == (2, "", 1)


def test_a_missing_positioner_and_wind_source_are_reported_with_a_remedy_each(heliocube, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(
        "[instruments]\nkind = 'real'\n[instruments.positioner]\nport = '/dev/serial/by-id/nothing'\n"
        "[bridge]\ninsecure = true\n[api]\nenabled = false\n"
    )
    code, out, _ = heliocube("self-check", "--json", "-c", file)
    found = by_subject(out)
    assert code == 4
    wrong = {subject for subject, each in found.items() if not each["ok"]} - {"clock"}
    assert wrong == {"positioner", "wind source"}
    assert all(found[subject]["remedy"] for subject in wrong)
    assert str(tmp_path / "records") in found["store"]["text"]
    assert "there is no /dev/serial/by-id/nothing" in found["positioner"]["text"]


@pytest.mark.parametrize("text", ["", "[api]\nenabled = false\n[instruments]\nkind = 'real'\n"])
@pytest.mark.parametrize("command", ["self-check", "config check"])
def test_the_configuration_of_a_unit_is_checked_for_the_role_of_that_unit(
    heliocube, tmp_path, monkeypatch, command, text
):
    file = tmp_path / "tracker.toml"
    file.write_text(text)
    named = ["-c", file] if command == "self-check" else [file]
    monkeypatch.setattr("daemon.commands.options.CONFIG_FOLDER", tmp_path)
    code, out, err = heliocube(*command.split(), *named)
    assert code == 2
    assert "as tracker: bridge.key_file" in out + err


def test_a_service_that_does_not_listen_is_reported_as_not_running(heliocube, config):
    config.write_text("[api]\nlisten = '127.0.0.1:1'\n[store]\ndirectory = 'records'\n")
    _, out, _ = heliocube("self-check", "--json", "-c", config)
    assert by_subject(out)["service"]["text"] == "does not run: nothing listens at 127.0.0.1:1"


@pytest.mark.parametrize(
    ("spoil", "said", "ok"),
    [
        (lambda path: None, f"version {VERSION}, ", True),
        (lambda path: set_version(path, VERSION - 1), f"makes it version {VERSION}", True),
        (lambda path: set_version(path, VERSION + 1), "written by a newer heliocube", False),
        (lambda path: path.write_text("no store"), "is not a store of heliocube", False),
        (lambda path: path.rename(path.with_name("heliocube.20260101T000000Z.damaged.sqlite")), "store salvage", False),
    ],
)
def test_the_self_check_reads_the_store_and_reports_its_version_or_what_is_wrong_with_it(
    heliocube, config, spoil, said, ok
):
    path = config.parent / "records" / FILE_NAME
    path.parent.mkdir()
    open_for_writing(path).close()
    spoil(path)
    code, out, _ = heliocube("self-check", "--json", "-c", config)
    found = by_subject(out)["store"]
    assert said in found["text"] + found["remedy"]
    assert found["ok"] is ok
    assert code == (0 if ok else 4)


def test_a_copy_of_the_store_that_will_not_fit_on_the_disk_is_reported_before_the_restart(
    heliocube, tmp_path, small_disk
):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[api]\nenabled = false\n[store]\ndirectory = '{small_disk}'\n[bridge]\ninsecure = true\n")
    open_for_writing(small_disk / FILE_NAME).close()
    set_version(small_disk / FILE_NAME, VERSION - 1)
    code, out, _ = heliocube("self-check", "--json", "-c", file)
    assert code == 4
    found = by_subject(out)
    assert "a copy needs 67 MB and 0 MB are free: make room" in found["store"]["remedy"]
    assert "make room" in found["disk"]["remedy"]


def set_version(path, version):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {version}")


def test_the_findings_about_a_running_service_come_from_its_own_state_and_health(serve):
    async def scenario(rig, call):
        async def findings():
            await asyncio.sleep(2)
            return list(service_findings((await call.get("/api/state")).json, (await call.get("/healthz")).json))

        await rig.until_mode(Mode.TRACKING, 120)
        found = await findings()
        assert not amiss(found)
        assert texts(found)["service"] == "runs as both: SIMULATED, tracking"
        assert texts(found)["positioner"].startswith("36A1 ")
        state = (await call.get("/api/state")).json
        for own in state["trackers"].values():
            own["tracker"]["pose"] = {"a_deg": -0.04, "b_deg": 90.0}
        assert texts(service_findings(state, {"troubles": []}))["positioner"].endswith(" at A +0.0, B 90.0 deg")
        assert texts(found)["wind source"].startswith("wind: 3.0 m/s, ")

        rig.wind_m_s = None
        rig.cables.positioner.link_up = rig.cables.voltmeter.link_up = False
        await rig.until(lambda: rig.service.trackers[0].alarms.active, 120, "an alarm")
        await asyncio.sleep(2 * STALE_S)
        found = amiss(await findings())
        assert {"positioner", "cube", "wind source"} <= set(found)
        assert re.fullmatch(r"wind: \d+ s ago, it is silent", found["wind source"].text)
        assert any(subject.startswith("alarm ") for subject in found)

    serve(scenario, safety={"wind_stale_s": STALE_S})


def test_a_service_that_was_not_restarted_after_an_upgrade_is_reported(tmp_path):
    settings = Settings.model_validate({"store": {"directory": tmp_path}})
    assert list(check_running_release(settings, "tracker")) == []
    (tmp_path / "release.json").write_text(json.dumps({"release": release()}))
    assert list(check_running_release(settings, "tracker")) == []
    (tmp_path / "release.json").write_text('{"release": "0.0.9"}')
    (found,) = check_running_release(settings, "tracker")
    assert (found.ok, found.text) == (False, "still runs heliocube 0.0.9")
    assert list(check_running_release(settings, "cube")) == []
