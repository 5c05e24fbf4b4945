"""One scan as one SenML pack in JSON (RFC 8428), and back. The receiving side takes nothing on trust."""

import json
import math
import re
from typing import Any

from daemon.base.records import FACES, FaceReading, Quality, Scan
from daemon.bridge.refusals import Refusal, ScanRefusedError
from daemon.bridge.sequence import ScanHead

UNIT = "W/m2"
EARLIEST_UTC_S = 2.0**28  # RFC 8428, section 4.5.3: smaller times are relative ones
LATEST_UTC_S = 4102444800.0  # 2100-01-01
OLDEST_FACE_S = 3600.0
LARGEST_W_M2 = 10_000.0
LARGEST_MONOTONIC_S = 1e10
LARGEST_SEQUENCE = 2**53 - 1  # the largest count that every JSON library reads exactly

_SOURCE = re.compile(r"([A-Za-z0-9][A-Za-z0-9_.-]{0,31})/", re.ASCII)
_SESSION = re.compile(r"[A-Za-z0-9_-]{1,32}", re.ASCII)
# How the reference sender begins a pack, and how it goes on after the faces.
_PACK_HEAD = re.compile(rb'\[\{"bn":"([A-Za-z0-9][A-Za-z0-9_.-]{0,31})/","bt":([0-9]{9,10}\.[0-9]{1,3}),"n":"')
_SEQUENCE_AND_SESSION = re.compile(
    rb',\{"n":"sequence","u":"count","v":([0-9]{1,16})\},\{"n":"session","vs":"([A-Za-z0-9_-]{1,32})"\},'
)
# A tuple, because `int | float` would be made anew for each of the ten numbers of a scan.
_NUMBERS = (int, float)
_QUALITY_OF = {f"{face}/quality": face for face in FACES}
_CALIBRATION = re.compile(r"[0-9]{8}-[0-9a-f]{8}", re.ASCII)
_REQUIRED_RECORDS = ("sequence", "session", "monotonic", "simulated")
_LABELS = {
    **dict.fromkeys(FACES, frozenset({"n", "u", "v", "t"})),
    **dict.fromkeys(_QUALITY_OF, frozenset({"n", "vs", "t"})),
    "sequence": frozenset({"n", "u", "v"}),
    "session": frozenset({"n", "vs"}),
    "monotonic": frozenset({"n", "u", "v"}),
    "simulated": frozenset({"n", "vb"}),
    "calibration": frozenset({"n", "vs"}),
}

_encoder = json.JSONEncoder(separators=(",", ":"), allow_nan=False)


def encode(scan: Scan) -> bytes:
    """Return `scan` as one SenML pack.

    Irradiances are rounded to 0.001 W/m2 and times to 1 ms. A face whose irradiance is not a number, or larger than
    any sun, is sent without a number; its quality is then never ``ok``.
    """
    records: list[dict[str, Any]] = []
    for name, reading in zip(FACES, scan.faces, strict=True):
        offset_s = reading.time_monotonic_s - scan.time_monotonic_s
        offset_s = round(max(min(offset_s, 0.0), -OLDEST_FACE_S), 3) if math.isfinite(offset_s) else -OLDEST_FACE_S
        when = {"t": offset_s} if offset_s else {}
        quality = reading.quality
        if abs(reading.irradiance_w_m2) <= LARGEST_W_M2:
            records.append({"n": name, "u": UNIT, "v": round(reading.irradiance_w_m2, 3), **when})
        elif quality is Quality.OK:
            quality = Quality.MISSING if math.isnan(reading.irradiance_w_m2) else Quality.IMPLAUSIBLE
        if quality is not Quality.OK:
            records.append({"n": f"{name}/quality", "vs": quality.value, **when})
    records += (
        {"n": "sequence", "u": "count", "v": scan.sequence},
        {"n": "session", "vs": scan.session},
        {"n": "monotonic", "u": "s", "v": round(scan.time_monotonic_s, 3)},
        {"n": "simulated", "vb": scan.simulated},
    )
    if scan.calibration:
        records.append({"n": "calibration", "vs": scan.calibration})
    records[0] = {"bn": f"{scan.source}/", "bt": round(scan.time_utc_s, 3), **records[0]}
    return _encoder.encode(records).encode()


def peek(payload: bytes) -> ScanHead | None:
    """Return the head of a pack in exactly the form that `encode` writes; None for any other form, valid or not."""
    beginning, counted = _PACK_HEAD.match(payload), _SEQUENCE_AND_SESSION.search(payload)
    if beginning is None or counted is None:
        return None
    return ScanHead(beginning[1].decode(), counted[2].decode(), int(counted[1]), float(beginning[2]))


def decode(payload: bytes) -> Scan:
    """Return the scan in a SenML pack, its monotonic times on the sender's clock.

    Raises
    ------
    ScanRefusedError
        Of kind ``malformed`` for everything that docs/bridge.md does not allow; nothing else is raised.
    """
    records = _records(payload)
    source, time_utc_s = _base(records)
    named: dict[str, dict[str, Any]] = {}
    for record in records:
        name = record.get("n") if isinstance(record, dict) else None
        if not isinstance(name, str) or name not in _LABELS:
            raise _malformed(f"has a record that the format does not know: {_shown(record)}")
        if name in named:
            raise _malformed(f"has two records named {name}")
        if not _LABELS[name].issuperset(record):
            raise _malformed(f"has labels in its record {name} that do not belong there: {_shown(record)}")
        named[name] = record
    for name in _REQUIRED_RECORDS:
        if name not in named:
            raise _malformed(f"has no record {name}")
    sequence = named["sequence"].get("v")
    if type(sequence) is not int or not (0 <= sequence <= LARGEST_SEQUENCE):
        raise _malformed(f"has a sequence that is not a count: {_shown(sequence)}")
    session = named["session"].get("vs")
    if not isinstance(session, str) or _SESSION.fullmatch(session) is None:
        raise _malformed(f"has a session that is not 1 to 32 letters, digits, '-' or '_': {_shown(session)}")
    simulated = named["simulated"].get("vb")
    if not isinstance(simulated, bool):
        raise _malformed(f"has a record simulated that is neither true nor false: {_shown(simulated)}")
    _check_unit(named["sequence"], "count")
    _check_unit(named["monotonic"], "s")
    monotonic_s = _number(named["monotonic"].get("v"), 0.0, LARGEST_MONOTONIC_S, "monotonic")
    calibration = named["calibration"].get("vs") if "calibration" in named else ""
    if not isinstance(calibration, str) or ("calibration" in named and _CALIBRATION.fullmatch(calibration) is None):
        raise _malformed(f"has a calibration that is not an identifier of a calibration: {_shown(calibration)}")
    east, south, west, zenith = (_face(name, named, time_utc_s, monotonic_s) for name in FACES)
    return Scan(
        source=source,
        session=session,
        sequence=sequence,
        time_utc_s=time_utc_s,
        time_monotonic_s=monotonic_s,
        east=east,
        south=south,
        west=west,
        zenith=zenith,
        simulated=simulated,
        calibration=calibration,
    )


def _records(payload: bytes) -> list[Any]:
    try:
        records = _decoder.decode(payload.decode())
    except (ValueError, RecursionError) as error:
        raise _malformed(f"is not JSON: {_shown(str(error))}") from None
    if not isinstance(records, list) or not records or not isinstance(records[0], dict):
        raise _malformed("is not a SenML pack, a JSON array of objects")
    return records


def _base(records: list[Any]) -> tuple[str, float]:
    base_name = records[0].pop("bn", None)
    found = _SOURCE.fullmatch(base_name) if isinstance(base_name, str) else None
    if found is None:
        raise _malformed(f"has a base name (bn) that is not the source and a slash: {_shown(base_name)}")
    base_time = records[0].pop("bt", None)
    if isinstance(base_time, _NUMBERS) and base_time < EARLIEST_UTC_S:
        # A clock without a battery begins in 1970.
        unset = "the clock of the cube's machine is not set"
        raise _malformed(f"has a base time (bt) before July 1978, {_shown(base_time)}: {unset}")
    return found[1], _number(base_time, EARLIEST_UTC_S, LATEST_UTC_S, "base time (bt)")


def _face(name: str, named: dict[str, dict[str, Any]], time_utc_s: float, monotonic_s: float) -> FaceReading:
    value, flag = named.get(name), named.get(f"{name}/quality")
    quality = Quality.OK
    if flag is not None:
        try:
            quality = Quality(str(flag.get("vs")))
        except ValueError:
            raise _malformed(f"has an unknown quality for {name}: {_shown(flag.get('vs'))}") from None
    if value is not None:
        _check_unit(value, UNIT)
        irradiance = _number(value.get("v"), -LARGEST_W_M2, LARGEST_W_M2, name)
        timed = value
    elif flag is not None and quality is not Quality.OK:
        irradiance = math.nan
        timed = flag
    else:
        raise _malformed(f"has no irradiance for {name} and no quality that says why")
    offset_s = _number(timed.get("t", 0), -OLDEST_FACE_S, 0.0, f"time (t) of {name}")
    return FaceReading(irradiance, quality, time_utc_s + offset_s, monotonic_s + offset_s)


def _check_unit(record: dict[str, Any], unit: str) -> None:
    if record.get("u") != unit:
        raise _malformed(f"has {record['n']} in {_shown(record.get('u'))} and not in {unit}")


def _number(value: object, low: float, high: float, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, _NUMBERS) or not (low <= value <= high):
        raise _malformed(f"has a {what} that is not a number from {low:g} to {high:g}: {_shown(value)}")
    return float(value)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a label occurs twice in one record")
    return found


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a JSON number")


_decoder = json.JSONDecoder(object_pairs_hook=_unique, parse_constant=_refuse_constant)


def _shown(value: object) -> str:
    """Return foreign content for a log line: one line, ASCII, short."""
    text = ascii(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _malformed(reason: str) -> ScanRefusedError:
    return ScanRefusedError(Refusal.MALFORMED, reason)
