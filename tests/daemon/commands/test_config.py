import json
import os
import stat
import sys

import pytest

from daemon.api.token import load_token
from daemon.base.errors import UserError
from daemon.bridge.signing import load_key
from daemon.commands.config import write_example
from daemon.commands.file_check import check_file
from daemon.config.settings import Settings
from tests.support.disk import synced_files

__all__ = ["synced_files"]

REAL = """
[instruments]
kind = "real"
[instruments.multiplexer]
digital_port = "Dev1/port0"
[instruments.voltmeter]
resource = "GPIB0::16::INSTR"
[bridge]
insecure = true
"""


@pytest.mark.parametrize("role", ["both", "cube", "tracker"])
def test_init_writes_a_file_and_a_key_that_check_finds_good(heliocube, tmp_path, role):
    folder = tmp_path / "new" / "rig"
    code, out, err = heliocube("config", "init", folder, "--role", role)
    assert (code, err) == (0, "")
    assert f"written: {folder / 'heliocube.toml'}, {folder / 'bridge.key'} and {folder / 'api.token'}" in out
    for secret in ("bridge.key", "api.token"):
        assert stat.S_IMODE((folder / secret).stat().st_mode) == 0o600
    assert len(load_token(folder / "api.token")) >= 32
    assert len(load_key(folder / "bridge.key")) == 32

    code, out, err = heliocube("config", "check", folder / "heliocube.toml")
    assert (code, err) == (0, "")
    assert out.startswith(f"{folder / 'heliocube.toml'} is good.\n")
    assert f"signed with {folder / 'bridge.key'}" in out
    assert "\x1b" not in out


def test_init_differs_from_the_defaults_only_in_secrets_store_and_a_trackers_bridge_address(heliocube, tmp_path):
    for role, listen in (("both", "127.0.0.1:20571"), ("tracker", "0.0.0.0:20571")):
        heliocube("config", "init", tmp_path / role, "--role", role)
        found = check_file(tmp_path / role / "heliocube.toml")
        bridge = Settings().bridge.model_copy(update={"key_file": tmp_path / role / "bridge.key", "listen": listen})
        api = Settings().api.model_copy(update={"token_file": tmp_path / role / "api.token"})
        store = Settings().store.model_copy(update={"directory": tmp_path / role / "records"})
        assert found == Settings().model_copy(update={"bridge": bridge, "api": api, "store": store})


def test_check_reads_the_weather_file_as_a_run_does(heliocube, tmp_path):
    path, weather = tmp_path / "heliocube.toml", tmp_path / "day.csv"
    path.write_text("[simulation]\nweather = 'day.csv'")
    weather.write_text("")
    code, _, err = heliocube("config", "check", path)
    assert (code, err.count("\n")) == (2, 2)
    assert f"simulation.weather: weather file {weather} is empty" in err
    weather.unlink()
    # Opening it would wait forever for a writer.
    os.mkfifo(weather)
    code, _, err = heliocube("config", "check", path)
    assert (code, err.count("\n")) == (2, 2)
    assert f"{weather} is no ordinary file: write its records into one" in err


def test_two_rigs_get_two_keys_and_two_tokens(heliocube, tmp_path):
    heliocube("config", "init", tmp_path / "a")
    heliocube("config", "init", tmp_path / "b")
    assert load_key(tmp_path / "a" / "bridge.key") != load_key(tmp_path / "b" / "bridge.key")
    assert load_token(tmp_path / "a" / "api.token") != load_token(tmp_path / "b" / "api.token")


@pytest.mark.skipif(sys.platform != "linux", reason="what is synced is seen in /proc")
def test_init_syncs_all_its_files_to_disk_so_that_they_survive_a_power_cut(heliocube, tmp_path, synced_files):
    assert heliocube("config", "init", tmp_path)[0] == 0
    assert synced_files == ["heliocube.toml", "bridge.key", "api.token"]


@pytest.mark.parametrize("there", ["heliocube.toml", "bridge.key", "api.token"])
def test_init_overwrites_no_existing_file_and_then_writes_nothing_at_all(heliocube, tmp_path, there):
    (tmp_path / there).write_text("mine")
    code, out, err = heliocube("config", "init", tmp_path)
    assert (code, out) == (2, "")
    assert err == (
        f"heliocube: {tmp_path / there} is there already and is not overwritten; name another folder or move it away\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "mine"


def test_init_into_a_place_that_is_no_folder_is_refused_in_one_sentence(heliocube, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = heliocube("config", "init", tmp_path / "file" / "rig")
    assert code == 2
    assert err == f"heliocube: {tmp_path / 'file' / 'rig'} cannot take the files: Not a directory\n"


def test_init_with_the_name_of_a_file_asks_for_its_folder(heliocube, tmp_path):
    code, _, err = heliocube("config", "init", tmp_path / "rig.toml")
    assert code == 2
    assert "rig.toml is the name of a file: name the folder that heliocube.toml is to be in\n" in err
    assert list(tmp_path.iterdir()) == []


def test_init_that_fails_half_way_takes_back_what_it_has_made(heliocube, tmp_path):
    (tmp_path / "bridge.key").symlink_to(tmp_path / "nowhere")
    code, _, err = heliocube("config", "init", tmp_path)
    assert (code, len(err.splitlines())) == (2, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["bridge.key"]

    code, _, err = heliocube("config", "init", tmp_path / "new" / ("x" * 300))
    assert code == 2
    assert err.endswith("cannot take the files: File name too long\n")
    assert not (tmp_path / "new").exists()


def test_check_lists_all_problems_on_standard_error_without_a_traceback(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text("[site]\nlatitude_deg = 95\n[law]\nname = 'fat'\n[bridge]\nlisten = 'here'\n")
    code, out, err = heliocube("config", "check", path)
    assert (code, out) == (2, "")
    assert err.splitlines()[0] == f"heliocube: {path} has 3 problems:"
    assert len(err.splitlines()) == 4
    assert "Traceback" not in err


def test_check_warns_of_addresses_that_are_not_on_this_machine(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    # No machine has these addresses (RFC 5737).
    path.write_text(
        "[bridge]\ninsecure = true\nlisten = '198.51.100.1:20571'\n[api]\nlisten = '198.51.100.2:20572'\n"
        "[sunspec]\nlisten = '198.51.100.3:5020'\n"
    )
    code, out, err = heliocube("config", "check", path, "--json")
    assert (code, err) == (0, "")
    keys = [
        sentence.partition(" is not an address of this machine now;")[0] for sentence in json.loads(out)["warnings"]
    ]
    assert keys == ["bridge.listen: 198.51.100.1", "api.listen: 198.51.100.2"], "there is no SunSpec device"


def test_check_reports_a_people_file_in_the_home_of_an_unknown_user(heliocube, tmp_path):
    (tmp_path / "bad.toml").write_text("[notify]\npeople_file = '~nosuch/x'\n")
    code, _, err = heliocube("config", "check", tmp_path / "bad.toml")
    assert code == 2
    assert "  people_file = '~nosuch/x': there is no such user; write the whole path\n" in err


def test_check_without_a_file_name_takes_the_file_of_the_environment_and_names_it(heliocube, tmp_path, monkeypatch):
    path, other = tmp_path / "heliocube.toml", tmp_path / "other.toml"
    path.write_text("")
    other.write_text("[site]\nlatitude_deg = 95\n")
    monkeypatch.setenv("HELIOCUBE_CONFIG", str(path))
    code, out, err = heliocube("config", "check")
    assert (code, err) == (0, "")
    assert out.startswith(f"{path} is good.\n")
    assert f"{other} has 1 problem" in heliocube("config", "check", other)[2]
    assert json.loads(heliocube("config", "check", "--json")[1])["file"] == str(path)

    monkeypatch.setenv("HELIOCUBE_CONFIG", str(other))
    assert f"{other} has 1 problem" in heliocube("config", "check")[2]
    monkeypatch.delenv("HELIOCUBE_CONFIG")
    code, out, err = heliocube("config", "check")
    assert (code, out) == (2, "")
    assert err == "heliocube: config check needs the service's configuration: name it as FILE or in HELIOCUBE_CONFIG\n"


def test_check_gives_a_remedy_for_the_home_of_an_unknown_user_and_for_a_link_to_itself(heliocube, tmp_path):
    path = tmp_path / "bad.toml"
    (tmp_path / "round").symlink_to("round")
    path.write_text("[store]\ndirectory = '~nosuch/x'\n[bridge]\nkey_file = 'round'\n")
    code, _, err = heliocube("config", "check", path)
    assert code == 2
    assert '  store.directory = "~nosuch/x": there is no such user; write the whole path\n' in err
    told = f"{tmp_path / 'round'} is a link that leads back to itself; remove it, or name another"
    assert f'  bridge.key_file = "round": {told}\n' in err


def test_check_says_when_scans_are_not_signed(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text("[bridge]\ninsecure = true\n")
    assert "NOT SIGNED" in heliocube("config", "check", path)[1]


def test_a_bare_config_shows_its_help(heliocube):
    _, out, err = heliocube("config")
    assert "check" in out + err
    assert "init" in out + err


def test_check_warns_of_a_stuck_line_that_no_self_test_sees_and_finds_the_file_good(heliocube, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"{REAL}[cube]\nself_test_channel = 7\n")
    code, out, err = heliocube("config", "check", file)
    assert (code, err) == (0, "")
    assert "warning      the self-test does not see line 0 stuck high, line 1 stuck high, line 2 stuck high," in out
    file.write_text("[cube]\nself_test_channel = 7\n")
    assert "warning" not in heliocube("config", "check", file)[1]


def test_init_writes_the_settings_of_a_chosen_cube_driver(tmp_path):
    write_example(tmp_path / "rig", "cube", "modbus")
    settings = check_file(tmp_path / "rig" / "heliocube.toml")
    assert settings.instruments.cube.driver == "modbus-pyranometers"
    assert "[instruments.cube.zenith]" in (tmp_path / "rig" / "heliocube.toml").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r'no cube "foo"; known are .*multiplexed'):
        write_example(tmp_path / "other", "cube", "foo")
    assert not (tmp_path / "other").exists()


def test_check_finds_a_file_good_if_one_role_can_run_with_it_and_says_which(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text(REAL)
    code, out, err = heliocube("config", "check", path)
    assert (code, err) == (0, "")
    assert "  runs as      cube\n" in out

    code, _, err = heliocube("config", "check", path, "--role", "tracker")
    assert code == 2
    assert "has 1 problem:\n  as tracker: instruments.positioner.port is missing: real instruments need" in err

    path.write_text('[instruments]\nkind = "real"\n')
    code, _, err = heliocube("config", "check", path)
    assert code == 2
    for role, lack in (("cube", "instruments.voltmeter.resource"), ("tracker", "instruments.positioner.port")):
        assert f"as both or {role}: {lack}" in err
        assert err.count(f"{lack} is missing") == 1
    assert "as cube: bridge.key_file" in err


def test_a_role_that_needs_the_shared_key_is_refused_without_it(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text("")
    assert heliocube("config", "check", path)[0] == 0
    code, _, err = heliocube("config", "check", path, "--role", "tracker")
    assert code == 2
    assert "as tracker: bridge.key_file: the role 'tracker' needs the key that cube and tracker share" in err


def test_check_reports_a_store_that_cannot_be_made_as_a_problem(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    (tmp_path / "file").write_text("")
    path.write_text(f'[store]\ndirectory = "{tmp_path / "file" / "records"}"\n')
    code, _, err = heliocube("config", "check", path)
    assert code == 2
    assert f"store.directory: {tmp_path / 'file'} is not a folder" in err


def test_check_finds_the_store_of_a_units_file_without_a_folder_where_the_unit_keeps_it(
    heliocube, tmp_path, monkeypatch
):
    """The service's user may not write beside the file; the unit does not either, and keeps the store elsewhere."""
    path, kept = tmp_path / "etc" / "east.toml", tmp_path / "lib" / "east"
    monkeypatch.setattr("daemon.store.records_folder.SYSTEMD_STATE_FOLDER", kept.parent)
    kept.mkdir(parents=True)
    path.parent.mkdir()
    path.write_text(
        '[instruments]\nkind = "real"\n[instruments.positioner]\nport = "/dev/no-port"\n[bridge]\ninsecure = true\n'
    )
    code, out, _ = heliocube("config", "check", "--role", "tracker", "--json", path)
    assert (code, json.loads(out)["sets_up"]["store"]) == (0, str(kept))


def test_check_with_probe_reports_all_unreachable_instruments_and_other_problems_at_once(heliocube, tmp_path):
    path = tmp_path / "heliocube.toml"
    (tmp_path / "records").write_text("no folder")
    path.write_text(
        '[instruments]\nkind = "real"\n[instruments.positioner]\nport = "/dev/no-such-positioner"\n'
        '[load]\ndriver = "chroma63600"\nresource = "ASRL/dev/no-such-load::INSTR"\n[bridge]\ninsecure = true\n'
    )
    code, out, err = heliocube("config", "check", "--role", "tracker", "--probe", path)
    assert (code, out) == (2, "")
    assert f"store.directory: {tmp_path / 'records'} is not a folder" in err
    assert "positioner: there is no /dev/no-such-positioner: is it plugged in and powered?; cable" in err
    assert "load: there is no /dev/no-such-load" in err
    path.write_text("")
    code, _, err = heliocube("config", "check", "--probe", path)
    assert (code, "there is nothing to open" in err) == (2, True)
