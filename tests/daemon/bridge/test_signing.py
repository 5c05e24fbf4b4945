"""Only scans that were signed with the key are taken, and a key file that others could read is refused."""

import base64
import hashlib
import hmac
import json
import os
import re
import stat

import jwt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.records import Quality
from daemon.bridge import senml, signing
from daemon.bridge.refusals import Refusal, ScanRefusedError
from daemon.bridge.signing import KeyFileError
from tests.support import DOCS

KEY = bytes(range(1, 33))
PAYLOAD = b'[{"bn":"cube/"}]'
SIGNED = signing.sign(PAYLOAD, KEY)
DOCUMENT = (DOCS / "bridge.md").read_text(encoding="utf-8")


def b64(data):
    return base64.urlsafe_b64encode(data).rstrip(b"=")


def jws(header, payload=PAYLOAD, key=KEY, digest=hashlib.sha256):
    """Make a JWS by hand, without the library under test."""
    signing_input = b64(json.dumps(header).encode()) + b"." + b64(payload)
    return signing_input + b"." + b64(hmac.new(key, signing_input, digest).digest())


def refusal(datagram, key=KEY):
    with pytest.raises(ScanRefusedError) as caught:
        signing.verify(datagram, key)
    return caught.value


def block(name):
    found = re.search(rf"^ *```{name}\n(.*?)\n *```", DOCUMENT, re.DOTALL | re.MULTILINE)
    assert found, f"docs/bridge.md has no block {name}"
    return "".join(line.strip() for line in found[1].splitlines()).encode()


@given(st.binary(min_size=1, max_size=1000), st.binary(min_size=32, max_size=64))
def test_a_signed_payload_is_verified_with_its_key_and_equals_what_pyjwt_signs(payload, key):
    signed = signing.sign(payload, key)
    assert signing.verify(signed, key) == payload
    assert signed == jwt.PyJWS().encode(payload, key, algorithm="HS256", headers=signing.HEADER).encode()


@pytest.mark.parametrize("part", [b"abcde", b"ab==", b"ab+d", b"ab/d", b"abc\n"])
def test_a_signed_datagram_that_is_not_in_the_compact_form_is_refused(part):
    signed = SIGNED.split(b".")[0] + b"." + part
    found = refusal(signed + b"." + b64(hmac.new(KEY, signed, hashlib.sha256).digest()))
    assert found.kind is Refusal.MALFORMED
    assert "compact form" in found.reason


@given(st.integers(0, len(SIGNED) * 8 - 1))
def test_a_single_flipped_bit_anywhere_is_refused(bit):
    flipped = bytearray(SIGNED)
    flipped[bit // 8] ^= 1 << bit % 8
    assert refusal(bytes(flipped)).kind in {Refusal.FORGED, Refusal.MALFORMED}


@given(st.integers(0, len(SIGNED) - 1))
def test_a_datagram_cut_short_anywhere_is_malformed(length):
    assert refusal(SIGNED[:length]).kind is Refusal.MALFORMED


@given(st.binary(max_size=2048))
def test_arbitrary_bytes_are_refused(datagram):
    refusal(datagram)


@given(
    st.dictionaries(
        st.sampled_from(["alg", "typ", "crit", "b64", "kid", "jwk"]),
        st.sampled_from(["HS256", "none", "heliocube-scan", ["b64"], [[]], {}, False, None, 5]),
    )
)
def test_a_correctly_signed_datagram_with_any_other_header_counts_as_forged(header):
    if header != signing.HEADER:
        assert refusal(jws(header)).kind is Refusal.FORGED


@pytest.mark.parametrize("header", [b"[]", b"null", b'{"alg":"HS256","typ":"heliocube-scan"', b"\xff", b"[" * 3000])
def test_a_header_that_is_no_object_is_refused(header):
    signing_input = b64(header) + b"." + b64(PAYLOAD)
    refusal(signing_input + b"." + b64(hmac.new(KEY, signing_input, hashlib.sha256).digest()))


def test_a_refusal_shows_at_most_eighty_letters_of_a_foreign_header():
    # The quotes and brackets of {'alg': '...'} take the first nine characters.
    reason = refusal(jws({"alg": "x" * 200})).reason
    assert f"has the header {{'alg': '{'x' * 71} and not " in reason


@pytest.mark.parametrize("letters", range(1, 5))
def test_a_foreign_header_of_any_length_is_quoted_in_the_refusal(letters):
    assert f"'{'x' * letters}'" in refusal(jws({"alg": "x" * letters})).reason


def test_no_algorithm_but_hs256_is_taken():
    for header, digest in (("HS512", hashlib.sha512), ("HS384", hashlib.sha384)):
        assert refusal(jws({"alg": header, "typ": "heliocube-scan"}, digest=digest)).kind is Refusal.FORGED
    unsigned = b64(b'{"alg":"none","typ":"heliocube-scan"}') + b"." + b64(PAYLOAD) + b"."
    assert refusal(unsigned).kind is Refusal.FORGED


def test_the_header_of_a_signed_datagram_may_have_any_order_and_blanks():
    assert signing.verify(jws({"typ": "heliocube-scan", "alg": "HS256"}), KEY) == PAYLOAD


def test_a_datagram_signed_with_another_key_is_forged_and_the_reason_names_the_remedy():
    refused = refusal(SIGNED, bytes(32))
    assert refused.kind is Refusal.FORGED
    assert "same key file" in refused.reason


def test_an_unsigned_pack_counts_as_forged_if_a_key_is_set():
    refused = refusal(PAYLOAD)
    assert refused.kind is Refusal.FORGED
    assert "not signed" in refused.reason


def test_the_example_in_the_bridge_docs_can_be_computed_from_its_steps_and_is_accepted():
    key = base64.urlsafe_b64decode(block("key") + b"=")
    pack = block("json")
    assert key == signing.EXAMPLE_KEY
    assert b64(block("header")) == block("header64")
    assert b64(pack) == block("payload64")
    assert len(pack) == 358
    signing_input = block("header64") + b"." + block("payload64")
    digest = hmac.new(key, signing_input, hashlib.sha256)
    assert digest.hexdigest().encode() == block("hmac")
    assert b64(digest.digest()) == block("signature64")
    datagram = signing_input + b"." + block("signature64")
    assert datagram == block("datagram")
    assert len(datagram) == 574

    scan = senml.decode(signing.verify(datagram, key))
    assert (scan.source, scan.sequence, scan.time_utc_s) == ("cube", 120, 1665742815.125)
    assert (scan.east.irradiance_w_m2, scan.south.quality) == (103.2, Quality.OVER_RANGE)
    assert scan.west.time_utc_s == pytest.approx(1665742814.798, abs=1e-6, rel=0)
    assert signing.sign(senml.encode(scan), key) == datagram


def test_every_kind_of_refusal_and_every_quality_is_in_the_bridge_docs():
    for word in [*Refusal, "lost", "accepted", *Quality]:
        assert f"`{word}`" in DOCUMENT


def write(path, content, mode=0o600):
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_a_written_key_is_loaded_again_and_only_its_owner_can_read_it(tmp_path):
    key = signing.generate_key()
    signing.write_key(tmp_path / "bridge.key", key)
    assert signing.load_key(tmp_path / "bridge.key") == key
    assert stat.S_IMODE((tmp_path / "bridge.key").stat().st_mode) == 0o600
    assert len(key) == 32
    assert key != signing.generate_key()


def test_a_key_file_is_never_overwritten(tmp_path):
    path = write(tmp_path / "bridge.key", b"precious")
    with pytest.raises(KeyFileError, match="not overwritten"):
        signing.write_key(path, KEY)
    assert path.read_bytes() == b"precious"


def test_a_key_in_a_folder_that_does_not_exist_is_not_written(tmp_path):
    with pytest.raises(KeyFileError, match="cannot be written: No such file"):
        signing.write_key(tmp_path / "nowhere" / "bridge.key", KEY)


@pytest.mark.skipif(os.name != "posix", reason="file modes are a POSIX matter")
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644, 0o610])
def test_a_key_that_others_can_read_is_refused_with_the_command_that_cures_it(tmp_path, mode):
    path = write(tmp_path / "bridge.key", b64(KEY), mode)
    with pytest.raises(KeyFileError) as caught:
        signing.load_key(path)
    assert f"run chmod 600 {path}" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b" \n", "is empty"),
        (b64(bytes(31)) + b"\n", "too short: it has 31 bytes"),
        (b"not base64url!\n", "not one line of base64url"),
        (b64(KEY) + b"\n" + b64(KEY)[:-1] + b"!", "not one line of base64url"),
        (b64(KEY) + b"\n" + b64(KEY[:31]), "too short"),
        (base64.b64encode(b"\xff" * 32), "not one line of base64url"),
        (b"A" * 45, "not one line of base64url"),
        (b"A" * 4000, "not one line of base64url"),
        (b64(bytes(range(32))), "the example that docs/bridge.md prints"),
    ],
)
def test_a_file_that_is_no_key_is_refused_with_its_name_and_a_remedy(tmp_path, content, words):
    path = write(tmp_path / "bridge.key", content)
    with pytest.raises(KeyFileError, match=words) as caught:
        signing.load_key(path)
    assert str(path) in str(caught.value)
    assert "heliocube config init" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_keys_can_be_in_force_and_the_first_signs(tmp_path):
    second = bytes(range(2, 34))
    path = write(tmp_path / "bridge.key", b64(KEY) + b"\r\n\n" + b64(second) + b"\n")
    assert signing.load_keys(path) == (KEY, second)
    assert signing.load_key(path) == KEY
    write(path, b"\n".join([b64(KEY)] * 3))
    with pytest.raises(KeyFileError, match="has 3 keys, and 2 can be in force: delete the old ones"):
        signing.load_keys(path)


def test_a_key_file_of_a_kibibyte_is_read_and_a_longer_one_is_refused(tmp_path):
    path = write(tmp_path / "bridge.key", b64(KEY).ljust(1024, b"\n"))
    assert signing.load_key(path) == KEY
    with pytest.raises(KeyFileError, match="not one line of base64url"):
        signing.load_key(write(path, b64(KEY).ljust(1025, b"\n")))


@pytest.mark.parametrize("ending", [b"", b"\n", b"\r\n", b"=\n"])
def test_a_key_may_end_in_any_line_end_and_with_padding(tmp_path, ending):
    assert signing.load_key(write(tmp_path / "bridge.key", b64(KEY) + ending)) == KEY


def test_a_missing_key_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(KeyFileError, match="does not exist: write a new one"):
        signing.load_key(tmp_path / "none")
    with pytest.raises(KeyFileError, match="cannot be read"):
        signing.load_key(tmp_path)
