"""Wind and safety over the broker: silent, garbled and old messages never count as safe."""

import asyncio
import math

import pytest

from daemon.base.records import Mode
from daemon.config.links import SafeInput, WindInput
from daemon.config.sections import SafetySettings
from daemon.mqtt.connection import Incoming
from daemon.mqtt.safety_inputs import SafeInputStow, WindReadings
from daemon.tracker.stow import WindStow
from tests.support.mqtt import SPEED, BrokerRig, observer, report_safe_inputs, run_services, settings_for, until


class Told:
    def __init__(self):
        self.now = {}

    def __call__(self, subject, sentence):
        if sentence is None:
            self.now.pop(subject, None)
        else:
            self.now[subject] = sentence


def wind(**settings):
    told, woken = Told(), []
    readings = WindReadings(
        WindInput(topic="lab/wind", **settings),
        SafetySettings().stow_wind_m_s,
        lambda: 40.0,
        lambda: woken.append(1),
        told,
    )
    return readings, WindStow(SafetySettings(), readings.strongest_since_last_read), told, woken


def said(payload, **marks):
    content = payload if isinstance(payload, bytes) else payload.encode()
    return Incoming("lab/wind", content, **{"retained": False, **marks})


of_unknown_age = pytest.mark.parametrize("mark", ["retained", "overdue"])


def test_wind_stows_at_the_upper_threshold_and_releases_below_the_lower_after_the_minimum_stay():
    readings, stow, _, woken = wind()
    readings.take(said("14.9"))
    assert stow.reason(0.0) is None
    assert not woken
    readings.take(said("15"))
    assert woken
    assert "wind 15.0 m/s" in stow.reason(5.0)
    for now_s in range(10, 905, 5):
        readings.take(said("12"))
        assert stow.reason(float(now_s)) is not None, "between the thresholds stow goes on"
    for now_s in range(905, 1800, 5):
        readings.take(said("9"))
        assert stow.reason(float(now_s)) is not None, "the minimum stay begins when the wind has become calm"
    readings.take(said("9"))
    assert stow.reason(1805.0) is None


def test_a_gust_between_two_checks_of_the_wind_is_not_missed():
    readings, stow, _, _ = wind()
    for speed in ("3", "22", "3"):
        readings.take(said(speed))
    assert "22.0" in stow.reason(5.0)


@pytest.mark.parametrize(
    ("payload", "part"),
    [
        (b"", "is not a wind speed"),
        (b"calm", "is not a wind speed"),
        (b"NaN", "is not a wind speed"),
        (b"-1", "is not a wind speed"),
        (b"1e400", "is not a wind speed"),
        (b"0_9", "is not a wind speed"),
        ("\uff13".encode(), "is not a wind speed"),
        (b"true", "is not a wind speed"),
        (b"[3]", "is not a wind speed"),
        (b'{"speed": 3}', "is not a wind speed"),
        (b"\xff\xfe", "is not a wind speed"),
        (b"1" * 70_000, "longer"),
    ],
)
def test_a_garbled_wind_message_is_reported_in_one_sentence_and_counts_as_silence(payload, part):
    readings, stow, told, _ = wind()
    assert stow.reason(0.0) is None
    for now_s in range(5, 305, 5):
        readings.take(said(payload))
        stow.reason(float(now_s))
    assert part in told.now["mqtt.wind of lab/wind"]
    assert "no wind reading" in stow.reason(305.0)
    readings.take(said("3"))
    assert not told.now
    assert stow.reason(310.0) is not None, "one good reading is no calm"


@pytest.mark.parametrize(
    ("path", "payload", "speed"),
    [
        ("wind.speed", '{"wind": {"speed": 20}}', 20.0),
        ("sensors.1.v", '{"sensors": [{"v": 1}, {"v": "21.5"}]}', 21.5),
    ],
)
def test_the_wind_input_reads_the_value_at_its_json_path(path, payload, speed):
    readings, _, _, _ = wind(json_path=path)
    readings.take(said(payload))
    assert readings.strongest_since_last_read() == speed


@pytest.mark.parametrize(
    "payload",
    ['{"wind": {}}', '{"wind": 3}', "[]", "3", "{", '{"wind": {"speed": 30, "speed": 3}}', '{"a": 1, "a": 1}'],
)
def test_a_wind_message_without_a_clear_value_at_the_json_path_is_reported_in_one_sentence(payload):
    readings, _, told, _ = wind(json_path="wind.speed")
    readings.take(said(payload))
    assert readings.strongest_since_last_read() is None
    (sentence,) = told.now.values()
    assert sentence.endswith(("nothing at wind.speed", "not JSON", "has 'speed' twice", "has 'a' twice"))


@pytest.mark.parametrize(("unit", "told"), [("km/h", "54"), ("kn", "29.1576674"), ("kt", "29.1576674")])
def test_wind_speeds_in_km_h_or_knots_are_converted_to_m_s(unit, told):
    readings, _, _, _ = wind(unit=unit)
    readings.take(said(told))
    assert readings.strongest_since_last_read() == pytest.approx(15.0)


@of_unknown_age
def test_a_retained_or_overdue_calm_wind_message_is_ignored_but_a_stormy_one_stows(mark):
    readings, stow, _, _ = wind()
    readings.take(said("2", **{mark: True}))
    assert readings.strongest_since_last_read() is None
    readings.take(said("30", **{mark: True}))
    assert stow.reason(0.0) is not None


@of_unknown_age
def test_only_a_fresh_message_shows_that_the_wind_sensor_works(mark):
    readings, _, _, _ = wind()
    readings.take(said("30", **{mark: True}))
    assert readings.heard_s is None
    readings.take(said("30"))
    assert readings.heard_s == 40.0


@pytest.mark.parametrize("speed", ["0", "0.5"])
def test_wind_speeds_of_0_and_0_5_m_s_are_valid_readings(speed):
    readings, _, told, _ = wind()
    readings.take(said(speed))
    assert readings.strongest_since_last_read() == float(speed)
    assert not told.now


def test_a_wind_message_of_64_kib_is_accepted_and_a_longer_one_refused():
    readings, _, told, _ = wind()
    readings.take(said(b"3".rjust(65_536)))
    assert readings.strongest_since_last_read() == 3.0
    readings.take(said(b"3".rjust(65_537)))
    assert "longer than 65536 bytes" in told.now["mqtt.wind of lab/wind"]


def safe(heard_s=0.0, **settings):
    told, woken = Told(), []
    return (
        SafeInputStow(SafeInput(topic="lab/safe", **settings), lambda: heard_s, lambda: woken.append(1), told),
        told,
        woken,
    )


def test_an_unsafe_message_stows_at_once_and_safe_ones_release_after_the_minimum_stay():
    source, _, woken = safe(stow_at_least_s=60.0)
    source.take(said("safe"))
    assert source.reason(0.0) is None
    source.take(said("unsafe"))
    assert woken
    assert source.reason(5.0) == "lab/safe says unsafe"
    assert source.reason(500.0) is not None, "silence after it does not release"
    source.take(said("safe"))
    assert source.reason(505.0) is not None
    for now_s in range(510, 565, 5):
        source.take(said("safe"))
        assert source.reason(float(now_s)) is not None
    source.take(said("safe"))
    assert source.reason(566.0) is None


def test_a_short_unsafe_message_between_two_checks_is_not_missed():
    source, _, _ = safe()
    for word in ("safe", "unsafe", "safe"):
        source.take(said(word))
    assert source.reason(0.0) is not None


def test_a_safe_message_that_unsafe_follows_before_the_next_check_releases_nothing():
    source, _, _ = safe(stow_at_least_s=60.0)
    for word in ("safe", "unsafe"):
        source.take(said(word))
    for now_s in range(0, 100, 5):
        assert source.reason(float(now_s)) == "lab/safe says unsafe"
    source.take(said("safe"))
    assert source.reason(100.0) is not None, "it has been safe for no minute yet"


def test_the_minimum_stay_runs_on_between_safe_messages_and_ends_only_with_one():
    source, _, _ = safe(stow_at_least_s=60.0)
    assert not source.stowing
    source.take(said("unsafe"))
    assert source.reason(0.0) is not None
    assert source.stowing
    for now_s in (5.0, 35.0):
        source.take(said("safe"))
        assert source.reason(now_s) is not None
    assert source.reason(59.0) is not None
    assert source.reason(65.0) is not None, "nobody has said safe since the minute is over"
    source.take(said("safe"))
    assert source.reason(66.0) is None


def test_a_safe_input_that_is_silent_after_a_restart_releases_nothing_even_at_a_late_first_check():
    source, _, _ = safe(stow_at_least_s=60.0)
    source.resume("stowed before the restart", 0.0)
    assert source.reason(100.0) is not None


def test_a_readable_safe_message_ends_the_reported_trouble_and_sets_the_age():
    source, told, _ = safe(heard_s=40.0)
    source.take(said("perhaps"))
    assert told.now
    assert source.status(41.0).age_s == math.inf
    source.take(said("safe"))
    assert not told.now
    assert source.status(100.0).age_s == 60.0


@pytest.mark.parametrize("noise", [None, b"", b"Safe", b"perhaps", b'{"x": 1}', b"null"])
def test_silence_or_unreadable_messages_on_the_safe_input_stow_after_the_time_limit(noise):
    source, told, _ = safe(stale_s=100.0)
    source.take(said("safe"))
    assert source.reason(0.0) is None
    for now_s in range(5, 105, 5):
        if noise is not None:
            source.take(said(noise))
        assert source.reason(float(now_s)) is None
    assert "has not said safe for 105 s" in source.reason(105.0)
    assert bool(told.now) is (noise is not None)


@of_unknown_age
def test_a_safe_input_with_only_retained_or_overdue_messages_stows_after_the_time_limit(mark):
    source, _, _ = safe(stale_s=100.0)
    assert source.reason(0.0) is None
    source.take(said("safe", **{mark: True}))
    assert source.reason(90.0) is None
    assert source.reason(101.0) is not None


@pytest.mark.parametrize(("good", "bad"), [("true", "false"), ("0", "1"), ("1.5", "-2")])
def test_json_truth_values_and_numbers_can_be_the_words_for_safe_and_unsafe(good, bad):
    source, told, _ = safe(json_path="ok", safe=good, unsafe=bad, stale_s=100.0)
    assert source.reason(0.0) is None
    source.take(said(f'{{"ok": {good}}}'))
    assert source.reason(400.0) is None, "without a safe message it would have been silent for too long"
    source.take(said(f'{{"ok": {bad}}}'))
    assert source.reason(405.0) == f"lab/safe says {bad}"
    assert not told.now


def test_a_storm_reported_over_mqtt_stows_the_tracker_and_an_unusable_wind_message_is_shown(broker, run_scaled):
    async def scenario():
        inputs = {"wind": {"topic": "weather/roof", "json_path": "wind.speed"}, "safe": {"topic": "dome/safe"}}
        async with observer(broker.port) as lab:
            rig = BrokerRig(asyncio.get_running_loop(), settings_for(broker.port, mqtt=inputs), SPEED)
            async with run_services(rig):
                await report_safe_inputs(rig, lab, {"weather/roof": {"wind": {"speed": 3}}, "dome/safe": "safe"})
                await rig.until_mode(Mode.TRACKING, 400)
                await lab.publish("weather/roof", {"gust": 3})
                troubles = await until(lambda: rig.mqtt.status.troubles, "a sentence")
                assert "mqtt.wind of weather/roof cannot be used: the message has nothing at wind.speed" in troubles
                await lab.publish("weather/roof", {"wind": {"speed": 25}})
                await rig.until_mode(Mode.STOW, 100)
                assert "wind 25.0 m/s" in rig.control.why
                await until(lambda: not rig.mqtt.status.troubles, "its end")

    run_scaled(scenario)


def test_a_stow_resumed_after_a_restart_lasts_its_minimum_stay_from_the_first_safe_message():
    source, _, _ = safe(stow_at_least_s=60.0)
    source.resume("stowed before the restart", 0.0)
    for now_s in range(0, 200, 5):
        assert source.reason(float(now_s)) == "stowed before the restart"
    for now_s in range(200, 255, 5):
        source.take(said("safe"))
        assert source.reason(float(now_s)) is not None
    assert source.status(250.0).release_in_s == 5.0
    source.take(said("safe"))
    assert source.reason(255.0) is None
    assert source.status(255.0).age_s == 255.0
