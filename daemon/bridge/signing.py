"""The bridge's key and signature: a JWS in compact form (RFC 7515) with HMAC SHA-256 and nothing else."""

import base64
import hmac
import json
import re
import secrets
from pathlib import Path

import jwt

from daemon.base.addresses import BridgeError
from daemon.base.files import read_secret, write_secret
from daemon.bridge.refusals import Refusal, ScanRefusedError

KEY_BYTES = 32
MOST_KEYS = 2
EXAMPLE_KEY = bytes(range(KEY_BYTES))  # printed in docs/bridge.md, hence no secret
HEADER = {"alg": "HS256", "typ": "heliocube-scan"}

_KEY_LINE = re.compile(rb"[A-Za-z0-9_-]+={0,2}")
_LONGEST_KEY_FILE = 1024
# 32 bytes are 43 characters, the last of which has two bits to spare that must be zero.
_SIGNATURE = re.compile(rb"[A-Za-z0-9_-]{42}[AEIMQUYcgkosw048]")
_PAYLOAD = re.compile(rb"[A-Za-z0-9_-]*")
_jws = jwt.PyJWS(algorithms=["HS256"])


class KeyFileError(BridgeError):
    """A key file cannot be used; the message names the file and the remedy."""


def sign(payload: bytes, key: bytes) -> bytes:
    """Return `payload` as a JWS in compact form, signed with `key`, byte for byte as PyJWT makes it."""
    signed = _HEADER_PART + b"." + base64.urlsafe_b64encode(payload).rstrip(b"=")
    return signed + b"." + _signature(signed, key)


def verify(datagram: bytes, *keys: bytes) -> bytes:
    """Return the payload of a JWS that was signed with one of `keys`.

    The cheapest checks come first, and all together take a fifth of PyJWT's time: a flood of forged datagrams must
    leave time for the true ones.

    Raises
    ------
    ScanRefusedError
        ``malformed`` for an incomplete JWS, ``forged`` for one of another kind or another key.
    """
    if datagram[:1] == b"[":
        raise ScanRefusedError(
            Refusal.FORGED, "is not signed, and this receiver has a key: set bridge.key_file at the sender too"
        )
    parts = datagram.split(b".", 3)
    if len(parts) != 3:
        raise ScanRefusedError(Refusal.MALFORMED, "is not a signed scan, or is cut short")
    if parts[0] != _HEADER_PART:
        _check_header(parts[0])
    if _SIGNATURE.fullmatch(parts[2]) is None:
        raise ScanRefusedError(Refusal.MALFORMED, "has no whole signature: it may be cut short")
    signed = datagram[: len(parts[0]) + 1 + len(parts[1])]
    if not any(hmac.compare_digest(_signature(signed, key), parts[2]) for key in keys):
        raise ScanRefusedError(
            Refusal.FORGED, "was not signed with this receiver's key: give both sides the same key file"
        )
    if _PAYLOAD.fullmatch(parts[1]) is None or len(parts[1]) % 4 == 1:
        raise ScanRefusedError(Refusal.MALFORMED, "is not in the compact form of a JWS")
    return _decode_base64url(parts[1])


def _decode_base64url(part: bytes) -> bytes:
    # The decoder ignores surplus padding.
    return base64.urlsafe_b64decode(part + b"==")


def _signature(signed: bytes, key: bytes) -> bytes:
    return base64.urlsafe_b64encode(hmac.digest(key, signed, "sha256"))[:-1]


def _check_header(part: bytes) -> None:
    """Refuse every header but ours: no other algorithm, no ``none``, no extension marked critical."""
    try:
        header = json.loads(_decode_base64url(part))
    except (ValueError, RecursionError):
        raise ScanRefusedError(Refusal.MALFORMED, "does not begin with the header of a JWS") from None
    if header != HEADER:
        raise ScanRefusedError(
            Refusal.FORGED,
            f"has the header {ascii(header)[:80]} and not {json.dumps(HEADER)}",
        )


def generate_key() -> bytes:
    """Return a new key of 32 bytes, from the operating system's generator: a seeded one would give it away."""
    return secrets.token_bytes(KEY_BYTES)


def write_key(path: Path, key: bytes) -> None:
    """Write `key` to a new file that only its owner can read; never overwrites. Raises `KeyFileError`."""
    line = base64.urlsafe_b64encode(key).rstrip(b"=") + b"\n"
    write_secret(path, line, f"the key file {path}", KeyFileError)


def load_key(path: Path) -> bytes:
    """Return the key in a file that signs: its first one. Raises `KeyFileError` like `load_keys`."""
    return load_keys(path)[0]


def load_keys(path: Path) -> tuple[bytes, ...]:
    """Return the keys in a file, one or two lines of base64url, 32 bytes or more each: the first one signs.

    Raises
    ------
    KeyFileError
        One sentence with the file and the remedy. The file may be readable by its owner only; Windows has no such file
        modes, and there they are not looked at.
    """
    remedy = "write a new one with 'heliocube config init', or copy that of the cube"
    called = f"the key file {path}"
    missing = f"{called} does not exist: {remedy}"
    content = read_secret(path, _LONGEST_KEY_FILE + 1, called, missing, KeyFileError, group_may_read=False)
    lines = content.split()
    if not lines:
        raise KeyFileError(f"{called} is empty: {remedy}")
    if len(content) > _LONGEST_KEY_FILE or any(map(_is_no_key, lines)):
        raise KeyFileError(f"{called} is not one line of base64url, or two: {remedy}")
    if len(lines) > MOST_KEYS:
        raise KeyFileError(f"{called} has {len(lines)} keys, and {MOST_KEYS} can be in force: delete the old ones")
    return tuple(_key(line, path, remedy) for line in lines)


def _is_no_key(line: bytes) -> bool:
    return _KEY_LINE.fullmatch(line) is None or len(line.rstrip(b"=")) % 4 == 1


def _key(line: bytes, path: Path, remedy: str) -> bytes:
    key = _decode_base64url(line.rstrip(b"="))
    if len(key) < KEY_BYTES:
        raise KeyFileError(
            f"the key in {path} is too short: it has {len(key)} bytes, and {KEY_BYTES} is the least; {remedy}"
        )
    if key == EXAMPLE_KEY:
        raise KeyFileError(f"the key in {path} is the example that docs/bridge.md prints for all to see: {remedy}")
    return key


_HEADER_PART = _jws.encode(b"", EXAMPLE_KEY, algorithm="HS256", headers=HEADER).encode("ascii").split(b".")[0]
