"""A scan survives the trip through its SenML pack; anything else is refused, and nothing worse happens."""

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.records import FACES, FaceReading, Quality, Scan
from daemon.bridge import senml, signing
from daemon.bridge.refusals import Refusal, ScanRefusedError
from daemon.bridge.sequence import ScanHead

UTC_S = 1665742815.125
STEADY_S = 86403.25


def reading(value=100.0, quality=Quality.OK, age_s=0.0):
    return FaceReading(value, quality, UTC_S - age_s, STEADY_S - age_s)


def scan(**changes):
    faces = {face: reading(100.0 + i, age_s=0.9 - 0.3 * i) for i, face in enumerate(FACES)}
    return replace(Scan("cube", "9f86d081884c7d65", 120, UTC_S, STEADY_S, **faces), **changes)


def pack(**changes):
    """A correct pack as JSON objects by name, with some records changed (None removes one)."""
    records = {record["n"]: record for record in json.loads(senml.encode(scan()))} | changes
    return json.dumps([record for record in records.values() if record is not None]).encode()


def refusal(payload):
    with pytest.raises(ScanRefusedError) as caught:
        senml.decode(payload)
    assert caught.value.kind is Refusal.MALFORMED
    return caught.value.reason


readings = st.builds(
    lambda value, quality, age_s: reading(
        value, Quality.MISSING if math.isnan(value) and quality is Quality.OK else quality, age_s
    ),
    st.floats(-10_000, 10_000) | st.just(math.nan),
    st.sampled_from(Quality),
    st.floats(0, 3600),
)
scans = st.builds(
    Scan,
    source=st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,31}", fullmatch=True),
    session=st.from_regex(r"[A-Za-z0-9_-]{1,32}", fullmatch=True),
    sequence=st.integers(0, 2**53 - 1),
    time_utc_s=st.just(UTC_S),
    time_monotonic_s=st.just(STEADY_S),
    east=readings,
    south=readings,
    west=readings,
    zenith=readings,
    simulated=st.booleans(),
)


@given(scans)
def test_a_scan_survives_encoding_as_senml_to_a_milliwatt_and_a_millisecond(sent):
    got = senml.decode(senml.encode(sent))
    assert (got.source, got.session, got.sequence, got.simulated) == (
        sent.source,
        sent.session,
        sent.sequence,
        sent.simulated,
    )
    assert got.time_utc_s == pytest.approx(sent.time_utc_s, abs=6e-4, rel=0)
    assert got.time_monotonic_s == pytest.approx(sent.time_monotonic_s, abs=6e-4, rel=0)
    for before, after in zip(sent.faces, got.faces, strict=True):
        assert after.quality is before.quality
        assert after.irradiance_w_m2 == pytest.approx(before.irradiance_w_m2, abs=6e-4, rel=0, nan_ok=True)
        assert after.time_utc_s == pytest.approx(before.time_utc_s, abs=6e-4, rel=0)
        assert after.time_monotonic_s == pytest.approx(before.time_monotonic_s, abs=6e-4, rel=0)


@given(scans)
def test_every_pack_is_legal_senml(sent):
    for record in json.loads(senml.encode(sent)):
        assert len({"v", "vs", "vb"} & record.keys()) == 1


@given(st.binary(max_size=2048))
def test_arbitrary_bytes_are_refused_and_raise_nothing_else(payload):
    refusal(payload)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.sampled_from(Quality),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)


@given(st.data())
def test_a_pack_with_any_value_replaced_is_decoded_or_refused_and_raises_nothing_else(data):
    records = json.loads(senml.encode(scan(south=reading(math.nan, Quality.LATE))))
    record = data.draw(st.sampled_from(records))
    record[data.draw(st.sampled_from(sorted(record)))] = data.draw(json_values)
    try:
        got = senml.decode(json.dumps(records).encode())
    except ScanRefusedError:
        return
    assert all(abs(f.irradiance_w_m2) <= 10_000 or f.quality is not Quality.OK for f in got.faces)
    assert math.isfinite(got.time_utc_s + got.time_monotonic_s)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"east": None}, "bn"),
        ({"west": None}, "no irradiance for west"),
        ({"west": None, "west/quality": {"n": "west/quality", "vs": "ok"}}, "no irradiance for west"),
        ({"west": {"n": "west", "u": "W/m2"}}, "west that is not a number"),
        ({"west": {"n": "west", "u": "W/m2", "v": "98"}}, "west that is not a number"),
        ({"west": {"n": "west", "u": "W/m2", "v": True}}, "west that is not a number"),
        ({"west": {"n": "west", "u": "W/m2", "v": 10_001}}, "west that is not a number"),
        ({"west": {"n": "west", "u": "W/m2", "v": math.nan}}, "not JSON"),
        ({"west": {"n": "west", "u": "W/m2", "v": math.inf}}, "not JSON"),
        ({"west": {"n": "west", "u": "kW/m2", "v": 1}}, "not in W/m2"),
        ({"west": {"n": "west", "u": "W/m2", "v": 1, "t": 0.001}}, r"time \(t\) of west"),
        ({"west": {"n": "west", "u": "W/m2", "v": 1, "t": -3601}}, r"time \(t\) of west"),
        ({"west": {"n": "west", "u": "W/m2", "v": 1, "bv": 5}}, "labels in its record west"),
        ({"west/quality": {"n": "west/quality", "vs": "fine"}}, "unknown quality for west"),
        ({"west/qualty": {"n": "west/qualty", "vs": "late"}}, "does not know"),
        ({"north": {"n": "north", "u": "W/m2", "v": 1}}, "does not know"),
        ({"again": {"n": "west", "u": "W/m2", "v": 1}}, "two records named west"),
        ({"nested": ["west"]}, "does not know"),
        ({"sequence": {"n": "sequence", "u": "count", "v": 5.0}}, "sequence that is not a count"),
        ({"sequence": {"n": "sequence", "u": "count", "v": -1}}, "sequence that is not a count"),
        ({"sequence": {"n": "sequence", "u": "count", "v": 2**53}}, "sequence that is not a count"),
        ({"sequence": {"n": "sequence", "u": "count", "v": True}}, "sequence that is not a count"),
        ({"sequence": {"n": "sequence", "u": "s", "v": 1}}, "not in count"),
        ({"sequence": None}, "no record sequence"),
        ({"session": {"n": "session", "vs": ""}}, "session that is not"),
        ({"session": {"n": "session", "vs": "a\nb"}}, "session that is not"),
        ({"session": {"n": "session", "vs": "s" * 33}}, "session that is not"),
        ({"monotonic": {"n": "monotonic", "u": "s", "v": -1}}, "monotonic that is not"),
        ({"monotonic": {"n": "monotonic", "u": "ms", "v": 1}}, "not in s"),
        ({"monotonic": None}, "no record monotonic"),
        ({"simulated": {"n": "simulated", "vb": 1}}, "neither true nor false"),
        ({"simulated": None}, "no record simulated"),
        ({"calibration": {"n": "calibration", "vs": 20220320}}, "calibration that is not an identifier"),
        ({"session": {"n": "session", "vs": 5}}, "session that is not"),
    ],
)
def test_a_pack_that_breaks_a_rule_is_refused_and_the_reason_names_the_place(changes, words):
    with pytest.raises(ScanRefusedError, match=words):
        senml.decode(pack(**changes))


@pytest.mark.parametrize("base_time", [0, 1e8, 4.2e9, 1e300, "1665742815", None])
def test_a_base_time_outside_1978_to_2099_or_that_is_no_number_is_refused(base_time):
    records = json.loads(senml.encode(scan()))
    records[0]["bt"] = base_time
    assert "bt" in refusal(json.dumps(records).encode())


def test_a_base_time_of_a_clock_that_is_not_set_is_refused_with_that_reason():
    records = json.loads(senml.encode(scan()))
    records[0]["bt"] = 36014.077
    said = "has a base time (bt) before July 1978, 36014.077: the clock of the cube's machine is not set"
    assert said in refusal(json.dumps(records).encode())


@pytest.mark.parametrize("base_time", [2**28, 4102444800])
def test_base_times_from_july_1978_to_the_end_of_the_century_are_taken_and_none_beyond(base_time):
    records = json.loads(senml.encode(scan()))
    records[0]["bt"] = base_time
    assert senml.decode(json.dumps(records).encode()).time_utc_s == base_time
    records[0]["bt"] = base_time - 1 if base_time == 2**28 else base_time + 1
    assert "bt" in refusal(json.dumps(records).encode())


@pytest.mark.parametrize(("record", "most", "too_much"), [
    ({"n": "monotonic", "u": "s"}, 10_000_000_000, 10_000_000_001),
    ({"n": "monotonic", "u": "s"}, 0, -0.001),
    ({"n": "sequence", "u": "count"}, 2**53 - 1, 2**53),
    ({"n": "sequence", "u": "count"}, 0, -1),
    ({"n": "west", "u": "W/m2"}, 10_000, 10_000.001),
    ({"n": "west", "u": "W/m2"}, -10_000, -10_000.001),
])  # fmt: skip
def test_each_number_of_a_pack_is_taken_up_to_its_bound_and_not_beyond(record, most, too_much):
    senml.decode(pack(**{record["n"]: record | {"v": most}}))
    assert record["n"] in refusal(pack(**{record["n"]: record | {"v": too_much}}))


def test_a_face_may_be_an_hour_old_and_no_older():
    oldest = {"n": "west", "u": "W/m2", "v": 1, "t": -3600}
    assert senml.decode(pack(west=oldest)).west.time_monotonic_s == STEADY_S - 3600.0
    refusal(pack(west=oldest | {"t": -3600.001}))


@pytest.mark.parametrize("base_name", ["cube", "/", "a/b/", "-cube/", "c" * 33 + "/", 5])
def test_a_base_name_that_is_no_source_is_refused(base_name):
    records = json.loads(senml.encode(scan()))
    records[0]["bn"] = base_name
    assert "bn" in refusal(json.dumps(records).encode())


@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 2048,
        b"[]",
        b"{}",
        b"[1]",
        b"\xff\xfe[]",
        pack().replace(b'"n": "zenith",', b'"n": "zenith", "v": 1.0,'),
        pack() + b"x",
        pack().decode().encode("utf-16"),
        b'[{"bn":"cube/","bt":' + b"9" * 2000 + b"}]",
    ],
)
def test_a_payload_that_is_not_one_json_array_of_objects_is_refused(payload):
    refusal(payload)


def test_the_reason_of_a_refusal_is_one_short_ascii_line_whatever_was_sent():
    reason = refusal(pack(session={"n": "session", "vs": "\x1b[31m\nété" * 100}))
    assert reason.isascii()
    assert reason.isprintable()
    assert len(reason) < 200


@pytest.mark.parametrize(("letters", "shown"), [(78, "'" + "!" * 78 + "'"), (79, "'" + "!" * 76 + "...")])
def test_a_refusal_shows_at_most_eighty_letters_of_foreign_text(letters, shown):
    assert refusal(pack(session={"n": "session", "vs": "!" * letters})).endswith(f": {shown}")


@pytest.mark.parametrize(
    ("value", "quality"),
    [(math.nan, Quality.MISSING), (math.inf, Quality.IMPLAUSIBLE), (-1e9, Quality.IMPLAUSIBLE)],
)
def test_an_ok_reading_without_a_possible_number_is_sent_as_missing_or_implausible(value, quality):
    got = senml.decode(senml.encode(scan(west=reading(value)))).west
    assert math.isnan(got.irradiance_w_m2)
    assert got.quality is quality


def test_the_numbers_of_a_pack_are_rounded_to_thousandths():
    sent = scan(west=FaceReading(123.45678, Quality.OK, UTC_S, STEADY_S - 0.12345))
    sent = replace(sent, time_utc_s=UTC_S + 0.00049, time_monotonic_s=STEADY_S + 0.00049)
    records = {record["n"]: record for record in json.loads(senml.encode(sent))}
    assert records["west"] == {"n": "west", "u": "W/m2", "v": 123.457, "t": -0.124}
    assert records["east"]["bt"] == UTC_S
    assert records["monotonic"]["v"] == STEADY_S


@pytest.mark.parametrize(("age_s", "offset_s"), [(-0.5, None), (0.0, None), (3600.0, -3600.0), (7200.0, -3600.0)])
def test_a_face_is_sent_as_no_younger_than_its_scan_and_no_older_than_an_hour(age_s, offset_s):
    records = {record["n"]: record for record in json.loads(senml.encode(scan(west=reading(age_s=age_s))))}
    assert records["west"].get("t") == offset_s


def test_a_scan_without_a_time_cannot_be_encoded():
    with pytest.raises(ValueError, match="not JSON compliant"):
        senml.encode(scan(time_utc_s=math.nan))


def test_a_pack_contains_no_blanks():
    assert b" " not in senml.encode(scan(west=reading(math.nan, Quality.LATE)))


def test_a_face_whose_time_is_not_known_is_sent_as_an_hour_older_than_its_scan():
    got = senml.decode(senml.encode(scan(west=FaceReading(1.0, Quality.STALE, math.nan, math.nan))))
    assert got.west.time_utc_s == got.time_utc_s - 3600


def test_ages_of_faces_come_from_the_steady_clock_when_utc_steps_within_a_scan():
    stepped = FaceReading(1.0, Quality.OK, UTC_S + 3600, STEADY_S - 0.5)
    assert senml.decode(senml.encode(scan(west=stepped))).west.time_utc_s == UTC_S - 0.5


def test_the_longest_signed_scan_fits_an_unfragmented_datagram():
    face = FaceReading(-9999.123, Quality.SELF_TEST_FAILED, 0, 9999999999.999 - 3599.999)
    longest = Scan("c" * 32, "s" * 32, 2**53 - 1, UTC_S, 9999999999.999, face, face, face, face, simulated=False)
    datagram = signing.sign(senml.encode(longest), bytes(range(1, 33)))
    assert len(datagram) == 1019
    assert senml.decode(signing.verify(datagram, bytes(range(1, 33)))).session == "s" * 32


@given(scans)
def test_a_peek_at_an_encoded_pack_gives_the_same_head_as_decoding_the_whole(sent):
    head, whole = senml.peek(senml.encode(sent)), senml.decode(senml.encode(sent))
    assert head == ScanHead(whole.source, whole.session, whole.sequence, whole.time_utc_s)


@pytest.mark.parametrize(
    ("ours", "other"), [(b'[{"bn"', b'[ {"bn"'), (b'"u":"count","v"', b'"v"'), (b'"session","vs"', b'"session", "vs"')]
)
def test_a_peek_at_a_pack_that_another_program_has_written_returns_nothing(ours, other):
    sent = senml.encode(scan())
    assert senml.peek(sent) is not None
    assert senml.peek(sent.replace(ours, other)) is None
