import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from daemon.commands.file_check import check_file
from daemon.config.file import ConfigError, load_settings, override
from daemon.config.keys import tables
from daemon.config.links import BridgeSettings
from daemon.config.sections import LimitSettings, SafetySettings, Sections
from daemon.config.settings import Settings
from daemon.config.template import reference, render_config
from tests.support import DOCS

TEN_MISTAKES = """\
[site]
latitude_deg = 148.7
altitude_m = "1156.125 m"

[cube]
scan_every_s = 1
[cube.west]
channel = 1

[law]
name = "mu_prime"

[windows]
mean_min = 2
decide_every_s = 300

[limits]
a_min_deg = 20
a_max_deg = 10

[safety]
stow_wind_kmh = 54
scan_stale_s = 1.5

[bridge]
listen = "localhost:20571"

[simulation]
start_utc = 2022-10-14T06:00:00
"""
THEIR_LINES = """\
  site.latitude_deg = 148.7: must be a number from -90 to 90 deg
  site.altitude_m = "1156.125 m": must be a number from -430 to 9000 m; did you mean 1156.125, without quotes?
  cube.scan_every_s = 1.0: is too short for 4 readings of 0.3 s to settle and 0.04 s to convert: they take 1.36 s; \
where another driver reads the faces, name it in instruments.cube.driver
  cube.west.channel = 1: is the input of cube.south.channel already; each face needs one of its own
  law.name = "mu_prime": must be "chronometric", "flat", "mu-prime", "optimal" or "sun-vector"; did you mean "mu-prime"?
  windows.mean_min = 2: there is no such key; did you mean windows.mean_s = 120?
  limits.a_min_deg = 20.0: must be below limits.a_max_deg (10 deg)
  safety.stow_wind_kmh = 54: there is no such key; did you mean safety.stow_wind_m_s = 15?
  safety.scan_stale_s = 1.5: must be at least two scans, 2 s (cube.scan_every_s is 1 s)
  bridge.listen = "localhost:20571": must be a numeric address and a port up to 65535, such as "0.0.0.0:20571" or \
"[::]:20571"
  simulation.start_utc = 2022-10-14T06:00:00: must be a date and time with its UTC offset, without quotes, such as \
2022-10-14T06:00:00Z"""


@pytest.fixture
def load(tmp_path):
    def load_text(text):
        path = tmp_path / "heliocube.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_settings(path)

    return load_text


@pytest.fixture
def problems(load):
    def problems_of(text):
        with pytest.raises(ConfigError) as caught:
            load(text)
        return list(caught.value.problems)

    return problems_of


def test_eleven_mistakes_are_listed_together_in_the_order_of_the_file(load, tmp_path):
    with pytest.raises(ConfigError) as caught:
        load(TEN_MISTAKES)
    expected = [f"{tmp_path / 'heliocube.toml'} has 11 problems:", *THEIR_LINES.splitlines()]
    assert str(caught.value).splitlines() == expected


def test_an_empty_file_is_the_defaults(load):
    assert load("") == Settings()


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("[bridge]\nmean_s = 120", "windows.mean_s"),
        ("mean_s = 120", "windows.mean_s"),
        ("[site]\nlattitude_deg = 48", "site.latitude_deg"),
        ("[site]\nlatitude = 48", "site.latitude_deg"),
        ("[safety]\nwind_stow_m_s = 12", "safety.stow_wind_m_s"),
        ("[law]\nName = 'flat'", "law.driver"),
        ("[cube]\nscan-every-s = 5", "cube.scan_every_s"),
        ("[cube]\nchannel = 5", "cube.east.channel"),
        ("[windows]\ncoverage = 0.5", "windows.minimum_coverage"),
        ("[windws]\nmean_s = 120", "windows"),
        ("[east]\nchannel = 1", "cube.east"),
        ("[limits]\na_max_rad = 0.5", "limits.a_max_deg = 28.64788976"),
        ("[safety]\nstow_wind_kts = 20", "safety.stow_wind_m_s = 10.28888889"),
        ("[instruments.voltmeter]\nrange_mv = 1000", "instruments.voltmeter.range_v = 1"),
    ],
)
def test_the_refusal_of_an_unknown_key_suggests_the_key_that_was_meant(problems, text, meant):
    (line,) = problems(text)
    assert line.endswith(f"; did you mean {meant}?")


def test_the_refusal_of_an_unknown_key_that_resembles_no_other_lists_the_known_keys(problems):
    assert problems("[law]\ncolour = 3") == [
        (
            "law.colour = 3: there is no such key; the keys of [law] are driver, shadow, uniform_threshold, albedo,"
            " thrift, travel_per_day_deg, moves_per_day, gain_uncertainty"
        )
    ]
    assert problems("[zzz]")[0].startswith("zzz: there is no such section; the sections are site, cube,")
    assert problems("[law.zzz]") == ["law.zzz: there is no such section; [law] has no sections"]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("cube = 3", "cube = 3: must be a section of its own, [cube]"),
        ("[[cube]]", "cube = [{}]: must be a section of its own, [cube]"),
        ("[cube]\neast = 0", "cube.east = 0: must be a section of its own, [cube.east]"),
        ("[cube.east]\nchannel = 1.5", "cube.east.channel = 1.5: must be a whole number from 0 to 15"),
        ("[motion]\nattempts = true", "motion.attempts = true: must be a whole number from 1 to 10"),
        ("[law]\nalbedo = nan", "law.albedo = nan: must be a number from 0 to 1"),
        ("[safety]\nstow_wind_m_s = inf", "safety.stow_wind_m_s = inf: must be a number above 0 and up to 40 m/s"),
        (
            "[safety]\nstow_wind_m_s = '36 kt'",
            'safety.stow_wind_m_s = "36 kt": must be a number above 0 and up to 40 m/s; did you mean 18.52, without',
        ),
        (
            "[bridge]\ninsecure = 'True'",
            'bridge.insecure = "True": must be true or false; did you mean true, without quotes?',
        ),
        ("[bridge]\naccept_from = ['10.0.0.1', 'x']", 'bridge.accept_from[1] = "x": must be a numeric address such as'),
        ("[bridge]\nsend_to = ['10.0.0.1:0']", 'bridge.send_to[0] = "10.0.0.1:0": must be a numeric address, of'),
        ("[bridge]\nsend_to = '127.0.0.1:1'", 'bridge.send_to = "127.0.0.1:1": must be a list in brackets'),
        ("[bridge]\nkey_file = ''", 'bridge.key_file = "": must be a path in quotes'),
        (
            "[bridge]\nmulticast_group = '10.0.0.1:9'",
            'bridge.multicast_group = "10.0.0.1:9": must be an IPv4 multicast',
        ),
        ("[bridge]\nmulticast_ttl = 0", "bridge.multicast_ttl = 0: must be a whole number from 1 to 32"),
        ("[instruments.voltmeter]\nrange_v = 2", "instruments.voltmeter.range_v = 2: must be 0.1, 1.0 or 10.0 V"),
        ("[simulation]\nstart_utc = 2022-10-14", "simulation.start_utc = 2022-10-14: must be a date and time with its"),
        ("[simulation]\nstart_utc = 'now'", 'simulation.start_utc = "now": must be a date and time with its UTC'),
        (
            "[simulation]\nweather = 'claer'",
            'simulation.weather = "claer": must be "clear", "overcast", "variable" or "broken" or a path in quotes;',
        ),
    ],
)
def test_the_refusal_of_a_wrong_value_says_what_would_be_right(problems, text, line):
    (found,) = problems(text)
    assert found.startswith(line)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "[safety]\nnight_above_w_m2 = 3",
            "safety.night_above_w_m2 = 3.0: must not be below safety.night_below_w_m2 (5 W/m2)",
        ),
        (
            "[safety]\nstow_wind_m_s = 8",
            "safety.release_wind_m_s = 10.0 (default): must be below safety.stow_wind_m_s (8 m/s)",
        ),
        ("[notify]\nquiet_until = '06:30'", 'notify.quiet_until = "06:30": needs notify.quiet_from'),
        ("[notify]\nquiet_from = '24:00'", 'notify.quiet_from = "24:00": must be hours and minutes of the day'),
        ("[notify]\nheartbeat = 'hc.lab'", 'notify.heartbeat = "hc.lab": must be a web address'),
        ("[safety]\nrelease_wind_m_s = 15", "safety.release_wind_m_s = 15.0: must be below safety.stow_wind_m_s"),
        (
            "[limits]\nb_min_deg = 50\n[safety]\nstow_b_deg = 20",
            "safety.stow_b_deg = 20.0: lies outside limits.b_min_deg and limits.b_max_deg (50 to 90 deg)",
        ),
        ("[windows]\nmean_s = 301", "windows.mean_s = 301.0: must not be longer than windows.decide_every_s (300 s)"),
        ("[windows]\nmean_s = 4", "windows.mean_s = 4.0: must not be shorter than cube.scan_every_s (5 s)"),
        (
            "[cube]\nself_test_channel = 6\nsecond_self_test_channel = 6",
            "cube.second_self_test_channel = 6: is the input of cube.self_test_channel; the self-test needs",
        ),
        (
            "[cube]\nself_test_channel = 3",
            "cube.self_test_channel = 3: is the input of cube.zenith.channel; the self-test needs",
        ),
        (
            "[cube.east]\ngain_w_m2_per_mv = 0.1",
            "cube.east.gain_w_m2_per_mv = 0.1: lets instruments.voltmeter.range_v (1 V) end at 120 W/m2",
        ),
        (
            "[bridge]\ninsecure = true\nkey_file = 'k'",
            "bridge.insecure = true: contradicts bridge.key_file, which asks for signed scans",
        ),
        (
            "[bridge]\nsend_to = ['127.0.0.1:1', '10.0.0.2:20571']",
            'bridge.send_to[1] = "10.0.0.2:20571": reaches beyond this machine, so bridge.key_file must name a key',
        ),
        (
            "[bridge]\nmulticast_interface = '10.0.0.2'",
            'bridge.multicast_interface = "10.0.0.2": has no effect without bridge.multicast_group',
        ),
    ],
)
def test_keys_that_contradict_each_other_are_refused_in_a_sentence_about_both(problems, text, line):
    (found,) = problems(text)
    assert found.startswith(line)


def test_a_self_test_reading_counts_in_the_time_of_a_scan(load, problems):
    four = "[cube]\nscan_every_s = 1.36\n[safety]\nscan_stale_s = 15\n"
    assert load(four).cube.scan_every_s == 1.36
    assert "for 5 readings" in problems(four.replace("\n[safety]", "\nself_test_channel = 7\n[safety]"))[0]


def test_a_rule_between_two_keys_is_not_reported_when_one_of_them_is_wrong_itself(problems):
    (line,) = problems("[safety]\nstow_wind_m_s = 54\nrelease_wind_m_s = 20")
    assert line.startswith("safety.stow_wind_m_s = 54: must be")
    (line,) = problems("[safety]\nstow_wind_kmh = 90\nrelease_wind_m_s = 20")
    assert line.endswith("did you mean safety.stow_wind_m_s = 25?")


def test_settings_made_in_python_keep_the_same_rules():
    with pytest.raises(ValidationError, match=r"safety.release_wind_m_s must be below safety.stow_wind_m_s \(15 m/s\)"):
        Settings(safety=SafetySettings(release_wind_m_s=20.0))
    with pytest.raises(ValidationError, match=r"limits.a_min_deg must be below"):
        Settings(limits=LimitSettings(a_min_deg=10.0, a_max_deg=5.0))


def test_a_face_keeps_its_own_defaults_for_the_keys_that_the_file_leaves_out(load):
    cube = load("[cube.zenith]\nchannel = 6\n[cube.west]\ngain_w_m2_per_mv = 9.8").cube
    assert (cube.zenith.channel, cube.zenith.tilt_deg) == (6, 0.0)
    assert (cube.west.channel, cube.west.gain_w_m2_per_mv, cube.west.tilt_deg) == (2, 9.8, 90.0)


def test_relative_paths_start_from_the_folder_of_the_file(load, tmp_path):
    found = load(
        "[bridge]\nkey_file = 'keys/bridge.key'\n[store]\ndirectory = '/var/lib/x'\n[simulation]\nweather = 'day.csv'"
    )
    assert found.bridge.key_file == tmp_path / "keys" / "bridge.key"
    assert found.store.directory == Path("/var/lib/x")
    assert found.simulation.weather == tmp_path / "day.csv"
    assert load("[simulation]\nweather = 'clear'").simulation.weather == "clear"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[site]\nname = SIRTA", "line 2, column 8: invalid value in: name = SIRTA (text needs quotes;"),
        ("x = 48,7", "line 1, column 7: expected newline"),
        (
            "[store]\ndirectory = 'a'\ndirectory = 'b'",
            "line 3, column 16: cannot overwrite a value in: directory = 'b'",
        ),
        ("[cube.east]\n[cube.east]\n", "line 2, column 11: cannot declare cube.east twice in: [cube.east]"),
        ('[store]\ndirectory = "C:\\users"', "line 2, column 18: invalid hex value in:"),
        ('name = "x', "line 1, column 10: unterminated string in:"),
        (b"name = '\xe9'", "byte 8 is not UTF-8; save the file as UTF-8 text"),
    ],
)
def test_invalid_toml_is_refused_with_the_place_of_the_mistake(problems, text, line):
    (found,) = problems(text)
    assert found.startswith(line)


def test_a_byte_order_mark_at_the_start_of_the_file_is_accepted(load):
    assert load(b"\xef\xbb\xbf[law]\nname = 'flat'\n").law.driver == "flat"


def test_a_missing_file_or_a_folder_is_refused_with_the_reason(tmp_path):
    with pytest.raises(ConfigError, match="there is no such file; 'heliocube config init DIR' writes"):
        load_settings(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_settings(tmp_path)


def test_checking_a_file_also_checks_the_files_that_it_names(tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text("[bridge]\nkey_file = 'bridge.key'\n[simulation]\nweather = 'day.csv'")
    with pytest.raises(ConfigError) as caught:
        check_file(path)
    key, weather = caught.value.problems
    assert key.startswith(f"bridge.key_file: the key file {tmp_path / 'bridge.key'} does not exist")
    assert weather.startswith(f"simulation.weather: there is no weather file at {tmp_path / 'day.csv'}, and it is not")

    (tmp_path / "bridge.key").write_text("A" * 43)
    (tmp_path / "bridge.key").chmod(0o644)
    with pytest.raises(ConfigError, match="can be read by others than its owner: run chmod 600"):
        check_file(path)


def test_the_command_line_changes_keys_under_the_same_rules():
    changed = override(Settings(), {"law": {"driver": "flat"}, "simulation": {"seed": 7}})
    assert (changed.law.driver, changed.simulation.seed) == ("flat", 7)
    with pytest.raises(ConfigError, match=r"(?s)^what was asked for has 1 problem:.*site.latitude_deg = 95.0: must be"):
        override(Settings(), {"site": {"latitude_deg": 95.0}})


@pytest.mark.parametrize("role", ["both", "cube", "tracker"])
def test_the_commented_example_file_gives_exactly_the_default_settings(load, role):
    assert load(render_config(role)) == Settings()


def walk(section, path=""):
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, BaseModel):
            yield f"{path}{name}", None
            yield from walk(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", value


def entries(text):
    """Every key of a commented file with the comment above it; keys that are commented out count too."""
    found, section, comment = {}, "", []
    for line in text.splitlines():
        if header := re.fullmatch(r"\[([a-z_.]+)\]", line):
            section = header[1]
            found[section] = " ".join(comment)
        elif key := re.fullmatch(r"#?([a-z][a-z0-9_]*) = .*", line):
            found[f"{section}.{key[1]}"] = " ".join(comment)
        comment = [*comment, line.removeprefix("# ")] if line.startswith("# ") else []
    return found


def test_the_commented_example_file_has_every_key_and_section_with_a_comment():
    found = entries(render_config("both"))
    known = [
        path
        for table in tables().values()
        if not table.only_for
        for path in (table.path, *(key.path for key in table.keys))
    ]
    assert list(found) == [path for path in known if path]
    assert {path for path, _ in walk(Sections())} <= set(found)
    assert "law.thrift" in found, "nor are the keys of laws that are not chosen left out"
    assert all(len(comment) > 12 for comment in found.values()), found


def test_the_keys_commented_out_in_the_example_file_are_valid_settings(load, tmp_path):
    text = re.sub(r"(?m)^#([a-z][a-z0-9_]* = )", r"\1", render_config("both"))
    # Two examples are valid only with the switch that they belong to.
    found = load(text.replace("\nenabled = false", "\nenabled = true").replace("\ntls = false", "\ntls = true"))
    assert found.simulation.start_utc is not None
    assert found.bridge.key_file == tmp_path / "bridge.key"
    sections = set(tables())
    assert [path for path, value in walk(found) if value is None and path not in sections] == []


def test_the_example_file_of_a_role_leaves_out_the_sections_that_the_role_does_not_read():
    cube, tracker = tomllib.loads(render_config("cube")), tomllib.loads(render_config("tracker"))
    assert "limits" not in cube
    assert "cube" in cube
    assert "limits" in tracker
    assert list(tracker["instruments"]) == ["kind", "bench", "positioner"]


def test_the_reference_document_is_current():
    written = (DOCS / "configuration.md").read_text()
    assert written == reference(), "run: python -m daemon.config.template"


words = st.sampled_from(
    [*Sections.model_fields, *BridgeSettings.model_fields, "east", "channel", "mean_s", "x", "a.b", "", "é\n"]
)
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.dates() | st.datetimes()
contents = st.dictionaries(
    words,
    st.recursive(
        scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=4), max_leaves=12
    ),
    max_size=6,
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])
@given(changes=st.dictionaries(st.sampled_from(list(Sections.model_fields)), contents, max_size=4))
def test_any_values_give_either_settings_or_a_list_with_one_line_per_problem(changes):
    try:
        found = override(Settings(), changes)
    except ConfigError as error:
        found = error
    assert isinstance(found, Settings) or len(str(found).splitlines()) == 1 + len(found.problems)
