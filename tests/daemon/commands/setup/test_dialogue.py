"""The course of a setup, without a terminal and without an instrument."""

import contextlib
import shutil

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.bridge.signing import generate_key, write_key
from daemon.commands.setup.dialogue import SetupDialogue
from daemon.commands.setup.saved_answers import SetupAnswers, answers_path, keep_answers, load_answers
from daemon.commands.setup.steps import MOVE, SKIPPED
from daemon.config import keys
from tests.support import ROOT

SITE = ["Roof", "48.7", "2.2", "156"]


@pytest.fixture
def file(tmp_path):
    return tmp_path / "tracker.toml"


def dialogue_of(file, *answers):
    dialogue = SetupDialogue(SetupAnswers(), file)
    for answer in answers:
        dialogue.take_answer(answer)
    return dialogue


def walk(dialogue, needed, moved=SKIPPED, until=None):
    """Answer every question up to a step: by `needed` or Enter, and an action by its outcome."""
    names = []
    while (step := dialogue.current_step()) is not None and step.name != until:
        names.append(step.name)
        if step.kind == "action":
            dialogue.set_answer(moved)
        else:
            dialogue.take_answer(needed.get(step.name, ""))
    return names


POZSOL = {"instruments.positioner.port": "/dev/heliocube-positioner", "key": "new"}
METER = {"instruments.voltmeter.resource": "GPIB0::16::INSTR"}


def test_setup_of_a_tracker_asks_for_site_positioner_key_and_limits_before_the_first_move(file):
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    names = walk(dialogue, POZSOL)
    assert names.index("look at the positioner") < names.index("limits.a_min_deg") < names.index(MOVE) == len(names) - 1
    assert "instruments.cube.driver" not in names
    limits = dialogue.settings().limits
    assert (limits.a_min_deg, limits.a_max_deg, limits.b_min_deg, limits.b_max_deg) == (-5, 5, 80, 90)
    assert dialogue.settings().real
    assert not dialogue.settings().instruments.bench
    assert dialogue.settings().bridge.listen == "0.0.0.0:20571"
    assert dialogue.settings().api.listen == "127.0.0.1:20572"


def test_setup_of_a_cube_asks_for_its_faces_and_trackers_and_has_no_move(file):
    dialogue = dialogue_of(file, "cube", "real", *SITE)
    names = walk(dialogue, {**METER, "cube.west.gain_w_m2_per_mv": "9.87", "bridge.send_to": "10.0.0.5:20571"})
    assert MOVE not in names
    assert "limits.a_min_deg" not in names
    assert dialogue.settings().cube.west.gain_w_m2_per_mv == 9.87
    assert dialogue.settings().bridge.send_to == ("10.0.0.5:20571",)
    # A tracker on the same machine has the default port, so that 'heliocube stop' reaches it.
    assert dialogue.settings().api.listen == "127.0.0.1:20573"


A_BENCHS_FILE = """
[instruments]
kind = "real"
bench = true
[instruments.positioner]
port = "/bench/positioner"
[simulation]
start_utc = 2022-06-21T12:00:00Z
anchor_utc = 2026-11-23T12:00:00Z
speed = 1.0
"""


@pytest.fixture
def bench(tmp_path):
    """Return the folder of a bench."""
    folder = tmp_path / "bench"
    folder.mkdir()
    (folder / "heliocube.toml").write_text(A_BENCHS_FILE)
    return folder


def test_setup_of_a_real_rig_takes_nothing_from_the_file_of_a_bench(file):
    file.write_text(A_BENCHS_FILE)
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    walk(dialogue, POZSOL, until="instruments.positioner.port")
    assert dialogue.default_answer() is None
    walk(dialogue, POZSOL)
    assert not [path for path in dialogue.values() if path.startswith("simulation.")]
    assert not dialogue.settings().instruments.bench


def test_setup_of_a_bench_refuses_an_existing_file_of_another_rig(file, bench):
    file.write_text("[mqtt]\nenabled = true\nhost = 'broker'\n")
    dialogue = dialogue_of(file, "tracker")
    with pytest.raises(UserError, match="practise with another file"):
        dialogue.take_answer("bench")
    dialogue.take_answer("real")
    assert dialogue.settings().mqtt.enabled
    again = dialogue_of(bench / "heliocube.toml", "tracker", "bench", str(bench))
    assert again.context.file_values["instruments.positioner.port"] == "/bench/positioner"


def test_setup_offers_nothing_of_the_bench_after_going_back_to_a_real_rig(file, bench):
    dialogue = dialogue_of(file, "tracker", "bench", str(bench), *SITE)
    walk(dialogue, {}, until="look at the positioner")
    while dialogue.back():
        pass
    for answer in ("tracker", "real", *SITE):
        dialogue.take_answer(answer)
    walk(dialogue, POZSOL, until="instruments.positioner.port")
    assert dialogue.default_answer() is None


@pytest.mark.parametrize(
    ("driver", "key", "answer"),
    [
        ("modbus", "instruments.cube.line", "tcp:192.168.1.40:502"),
        ("scanning", "instruments.cube.resource", "GPIB0::9::INSTR"),
        ("labjack", "instruments.cube.line", "tcp:192.168.1.41:502"),
    ],
)
def test_setup_asks_for_the_address_of_the_instrument_of_each_cube_driver(file, driver, key, answer):
    dialogue = dialogue_of(file, "cube", "real", *SITE, "yes", driver)
    more = {"instruments.cube.channels": "101 102 103 104", "bridge.send_to": "10.0.0.5:20571"}
    names = walk(dialogue, {key: answer, **more})
    assert key in names
    assert "instruments.multiplexer.digital_port" not in names
    assert dialogue.settings().instruments.cube.driver.startswith(driver)


@pytest.mark.parametrize(
    ("before", "answer", "sentence"),
    [
        ([], "both of them", "say both, cube or tracker"),
        (["tracker"], "r2", "say real or bench"),
        (["tracker", "bench"], "/nowhere", "is the bench running"),
        (["tracker", "bench"], "~nosuch/b", '"~nosuch/b": there is no such user; write the whole path'),
        (["tracker", "real"], "", "this has no default: it takes text"),
        (["tracker", "real"], "Ro\x1b[Df", "has a key that is no letter, such as an arrow"),
        (["tracker", "real"], "Caf\udce9", "or a letter that is not UTF-8: type it again without"),
        (["tracker", "real", "Roof"], "", "this has no default: it takes a number from -90 to 90 deg"),
        (["tracker", "real", "Roof"], "91", "must be a number from -90 to 90 deg"),
        (["tracker", "real", "Roof"], "nan", "is not a number from -90 to 90 deg"),
        (["tracker", "real", "Roof"], "48.7 m", "is not a number from -90 to 90 deg"),
        (["tracker", "real", *SITE], "no", "put the clock right"),
        (["tracker", "real", *SITE, "yes", "", ""], "/dev/ttyACM0", "may be another"),
    ],
)
def test_a_wrong_answer_in_setup_is_refused_at_once_in_one_sentence_and_changes_nothing(file, before, answer, sentence):
    dialogue = dialogue_of(file, *before)
    kept = dialogue.saved_answers
    with pytest.raises(UserError, match=sentence) as refusal:
        dialogue.take_answer(answer)
    assert "\n" not in str(refusal.value)
    assert dialogue.saved_answers == kept


def test_numbers_are_taken_with_their_units(file):
    dialogue = dialogue_of(file, "tracker", "real", "Roof", "48,7 deg", "2.2", "0.156 km")
    assert dialogue.settings().site.altitude_m == 156.0
    walk(dialogue, {**POZSOL, "safety.stow_wind_m_s": "54 km/h"})
    assert dialogue.settings().safety.stow_wind_m_s == 15.0


@pytest.mark.parametrize(
    ("name", "said", "meant"),
    [
        ("safety.stow_wind_m_s", "30 kt", 15.43333333),
        ("limits.a_min_deg", "−4.5°", -4.5),
        ("instruments.positioner.slowest_deg_per_s", "0.5 °/s", 0.5),
        ("cube.minimum_w_m2", "-20 W/m²", -20.0),
        ("safety.stow_at_least_s", "2 h", 7200.0),
        ("safety.stow_at_least_s", "15 min", 900.0),
        ("instruments.multiplexer.settle_s", "300 ms", 0.3),
    ],
)
def test_units_are_taken_as_people_write_them(name, said, meant):
    assert keys.parse_quantity(said, keys.keys()[name]) == meant


def test_a_number_typed_with_its_unit_keeps_all_its_digits(file):
    dialogue = dialogue_of(file, "cube", "real", "Roof", "48.717607 deg", "-122.4194161 degrees", "156.254 m")
    site = dialogue.settings().site
    assert (site.latitude_deg, site.longitude_deg, site.altitude_m) == (48.717607, -122.4194161, 156.254)
    walk(dialogue, {**METER, "bridge.send_to": "10.0.0.5:20571", "cube.east.gain_w_m2_per_mv": "10.1234 W/m2 per mV"})
    assert dialogue.settings().cube.east.gain_w_m2_per_mv == 10.1234


def test_limits_that_contradict_each_other_are_refused_where_they_are_answered(file):
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    walk(dialogue, POZSOL, until="limits.a_max_deg")
    with pytest.raises(UserError, match=r"must be below limits\.a_max_deg"):
        dialogue.take_answer("-10")


def test_the_inputs_of_the_faces_are_taken_in_any_order_and_each_only_once(file):
    dialogue = dialogue_of(file, "cube", "real", *SITE)
    walk(dialogue, {**METER, "cube.east.channel": "1", "cube.south.channel": "0"}, until="cube.zenith.channel")
    with pytest.raises(UserError, match=r"is the input of cube\.east\.channel already"):
        dialogue.take_answer("1")
    walk(dialogue, {"bridge.send_to": "10.0.0.5:20571"})
    assert [getattr(dialogue.settings().cube, face).channel for face in FACES] == [1, 0, 2, 3]
    while dialogue.back() and dialogue.current_step().name != "cube.east.channel":
        pass
    walk(dialogue, {"cube.east.channel": "3", "cube.zenith.channel": "1"})
    assert [getattr(dialogue.settings().cube, face).channel for face in FACES] == [3, 0, 2, 1]


@pytest.mark.parametrize(
    ("role", "needed"),
    [
        ("tracker", {"safety.stow_wind_m_s": "8", "safety.release_wind_m_s": "6"}),
        ("cube", {"cube.east.gain_w_m2_per_mv": "0.2", "instruments.voltmeter.range_v": "10"}),
    ],
)
def test_setup_takes_settings_that_depend_on_each_other_together(file, role, needed):
    dialogue = dialogue_of(file, role, "real", *SITE)
    walk(dialogue, {**METER, **POZSOL, "bridge.send_to": "10.0.0.5:20571", **needed})
    assert {name: dialogue.values()[name] for name in needed} == {name: float(text) for name, text in needed.items()}


@pytest.mark.parametrize(
    ("asked", "answer", "other"),
    [
        ("cube.scan_every_s", "60", "safety.scan_stale_s"),
        ("limits.b_max_deg", "88", "safety.night_b_deg"),
    ],
)
def test_setup_names_a_setting_it_does_not_ask_for_when_an_answer_contradicts_it(file, asked, answer, other):
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    walk(dialogue, POZSOL, until=asked)
    words = f"{other} is not asked for here: give an answer that fits it, and change both"
    with pytest.raises(UserError, match=words) as said:
        dialogue.take_answer(answer)
    assert str(said.value).startswith(f"{other} = ")


@pytest.mark.parametrize(
    ("role", "own", "offered"),
    [
        ("cube", None, None),
        ("tracker", None, "0.0.0.0:20571"),
        ("tracker", "listen = '127.0.0.1:20600'", "0.0.0.0:20600"),
        ("tracker", "listen = '192.168.1.20:20571'", "192.168.1.20:20571"),
        ("cube", "send_to = ['127.0.0.1:20571', '10.0.0.5:20571']", ["127.0.0.1:20571", "10.0.0.5:20571"]),
        ("cube", "multicast_group = '239.255.20.71:20571'\nsend_to = []", []),
        ("tracker", "transport = 'mqtt'\nlisten = '127.0.0.1:20571'\n[mqtt]\nenabled = true", "127.0.0.1:20571"),
    ],
)
def test_setup_offers_no_bridge_address_that_ends_on_this_machine_for_a_rig_of_two_machines(file, role, own, offered):
    if own is None:
        shutil.copy(ROOT / "deploy" / "examples" / f"{role}.toml", file)
    else:
        file.write_text(f"[bridge]\nkey_file = 'bridge.key'\n{own}\n")
    way = "bridge.send_to" if role == "cube" else "bridge.listen"
    dialogue = dialogue_of(file, role, "real", *SITE)
    walk(dialogue, {**METER, **POZSOL}, until=way)
    assert dialogue.default_answer() == offered


def test_setup_of_a_bench_offers_a_loopback_bridge_address(file, bench):
    (bench / "heliocube.toml").write_text(A_BENCHS_FILE + "[bridge]\nlisten = '127.0.0.1:20571'\n")
    dialogue = dialogue_of(file, "tracker", "bench", str(bench), *SITE)
    walk(dialogue, {}, until="bridge.listen")
    assert dialogue.default_answer() == "127.0.0.1:20571"


def test_setup_offers_the_earlier_answer_after_going_back(file):
    dialogue = dialogue_of(file, "tracker", "real", "Roof", "48.7")
    assert dialogue.back()
    assert (dialogue.current_step().name, dialogue.default_answer()) == ("site.latitude_deg", 48.7)
    dialogue.take_answer("-33.9")
    assert dialogue.settings().site.latitude_deg == -33.9
    while dialogue.back():
        pass
    assert dialogue.current_step().name == "role"


def test_setup_continues_where_it_was_left(file):
    dialogue = dialogue_of(file, "tracker", "real", "Roof", "48.7")
    dialogue.back()
    place = answers_path(file)
    assert place.name == "tracker.setup.json"
    keep_answers(place, dialogue.saved_answers)
    again = SetupDialogue(load_answers(place), file)
    assert again.current_step() == dialogue.current_step()
    assert again.default_answer() == 48.7


@pytest.mark.parametrize("text", ["", "{}}", '{"form": 2}', '{"answers": {"role": {}}}'])
def test_answers_that_cannot_be_read_are_refused_with_the_remedy(file, text):
    answers_path(file).write_text(text)
    with pytest.raises(UserError, match="begin with --anew"):
        load_answers(answers_path(file))


def test_an_existing_file_gives_setup_its_defaults_except_for_wide_limits(file):
    file.write_text("[site]\nname = 'Old'\nlatitude_deg = 1.0\n[limits]\na_min_deg = -40.0\n[law]\nname = 'flat'\n")
    dialogue = dialogue_of(file, "tracker", "real", "", "", "2", "3")
    walk(dialogue, POZSOL)
    found = dialogue.settings()
    assert (found.site.name, found.site.latitude_deg, found.law.driver) == ("Old", 1.0, "flat")
    assert found.limits.a_min_deg == -5.0


def test_setup_refuses_a_file_with_tracker_tables_as_one_to_edit_by_hand(file):
    file.write_text("[[tracker]]\nname = 'east'\n")
    with pytest.raises(UserError, match="by hand"):
        SetupDialogue(SetupAnswers(), file)


def test_setup_checks_the_key_file_of_the_other_machine(file):
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    walk(dialogue, POZSOL, until="key")
    with pytest.raises(UserError, match="does not exist"):
        dialogue.take_answer("carried.key")
    with pytest.raises(UserError, match="there is no such user; write the whole path"):
        dialogue.take_answer("~nosuch/carried.key")
    write_key(file.parent / "carried.key", generate_key())
    dialogue.take_answer("carried.key")
    assert dialogue.key_file() == "carried.key"


def test_setup_takes_half_of_the_measured_speed_as_the_slowest_speed(file):
    dialogue = dialogue_of(file, "tracker", "real", *SITE)
    names = walk(dialogue, {**POZSOL, "way of the first move": "yes"}, moved=0.58)
    assert names[-4:] == [
        "way of the first move",
        "instruments.positioner.slowest_deg_per_s",
        "unplugged",
        "supply",
    ]
    assert dialogue.settings().instruments.positioner.slowest_deg_per_s == 0.29


@settings(max_examples=20, deadline=None)
@given(st.lists(st.one_of(st.text(max_size=12), st.sampled_from(["", "yes", "real", "12", "tracker"])), max_size=20))
def test_setup_takes_any_typed_text_as_an_answer_or_refuses_it_with_a_user_error(tmp_path_factory, typed):
    dialogue = SetupDialogue(SetupAnswers(), tmp_path_factory.getbasetemp() / "nothing.toml")
    for text in typed:
        if dialogue.current_step().kind == "action":
            dialogue.set_answer(SKIPPED)
        with contextlib.suppress(UserError):
            dialogue.take_answer(text)
    assert dialogue.settings().real
