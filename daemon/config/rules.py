"""Rules between keys. Each is a function of the settings whose docstring is its sentence in the reference."""

import math
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np

from daemon.base.records import FACES
from daemon.base.words import pluralise
from daemon.config.conflict import Conflict
from daemon.config.link_rules import LINK_RULES
from daemon.config.plugin_sections import LAW, MULTIPLEXED
from daemon.config.sections import Sections
from drivers.settings import canonical_address, exclusive_resource
from solar.frames import equator_azimuth_deg

# The Keithley 2000 reads to 120 % of its range; autozero doubles the time of a conversion.
_OVER_RANGE = 1.2
_AUTOZERO = 2
_BRIGHT_SUN_W_M2 = 1000.0
# The time that an electronic load takes for the exchanges of one point, and for the beginning and end of a sweep.
_LOAD_EXCHANGES_S = 0.03
_SWEEP_ENDS_S = 0.2
# The bridge takes times of scans from July 1978 to the end of 2099.
FIRST_START, END_OF_STARTS = datetime(1979, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
SELF_TESTS = ("self_test_channel", "second_self_test_channel")


def conflicts(settings: Sections) -> list[Conflict]:
    """Return every breach of a rule; empty when the settings are consistent."""
    multiplexed = has_multiplexer(settings)
    rules = [rule for rule in RULES if multiplexed or rule not in _MULTIPLEXER_RULES]
    return [conflict for rule in rules for conflict in rule(settings)]


def has_multiplexer(settings: Sections) -> bool:
    """Return whether a process with these settings may read the faces through a multiplexer."""
    instruments = settings.instruments
    # Without the meter's address no real face can be read here: another machine has the cube, with whatever driver.
    there = instruments.kind != "real" or instruments.voltmeter.resource is not None
    return instruments.cube.driver == MULTIPLEXED and there


def limits_are_ordered(settings: Sections) -> Iterator[Conflict]:
    """`limits.a_min_deg` is below `limits.a_max_deg`, and `limits.b_min_deg` below `limits.b_max_deg`."""
    for axis in "ab":
        low, high = getattr(settings.limits, f"{axis}_min_deg"), getattr(settings.limits, f"{axis}_max_deg")
        if not low < high:
            other = f"limits.{axis}_max_deg"
            yield Conflict(f"limits.{axis}_min_deg", f"must be below {other} ({high:g} deg)", (other,))


def positions_are_inside_limits(settings: Sections) -> Iterator[Conflict]:
    """Night, stow and snow positions lie inside `limits`; only the default of the snow position is cut to them."""
    for position in ("night", "stow", "snow"):
        for axis in "ab":
            ends = (f"limits.{axis}_min_deg", f"limits.{axis}_max_deg")
            low, high = getattr(settings.limits, f"{axis}_min_deg"), getattr(settings.limits, f"{axis}_max_deg")
            name = f"{position}_{axis}_deg"
            angle_deg = getattr(settings.safety, name)
            cut = position == "snow" and angle_deg == type(settings.safety).model_fields[name].default
            if low < high and not cut and not low <= angle_deg <= high:
                reason = f"lies outside {ends[0]} and {ends[1]} ({low:g} to {high:g} deg)"
                yield Conflict(f"safety.{position}_{axis}_deg", reason, ends)


def each_face_has_its_channel(settings: Sections) -> Iterator[Conflict]:
    """Each face has a multiplexer input of its own, and the self-tests have two others."""
    owner: dict[int, str] = {}
    for name in FACES:
        key, channel = f"cube.{name}.channel", getattr(settings.cube, name).channel
        if channel in owner:
            reason = f"is the input of {owner[channel]} already; each face needs one of its own"
            yield Conflict(key, reason, (owner[channel],))
        owner.setdefault(channel, key)
    for name in SELF_TESTS:
        key, test = f"cube.{name}", getattr(settings.cube, name)
        if test is None:
            continue
        if test in owner:
            reason = f"is the input of {owner[test]}; the self-test needs a short-circuited input of its own"
            yield Conflict(key, reason, (owner[test],))
        owner.setdefault(test, key)


def each_channel_has_an_address(settings: Sections) -> Iterator[Conflict]:
    """Every input that is read is one that `instruments.multiplexer.addresses` knows."""
    count = len(settings.instruments.multiplexer.addresses)
    channels = {f"cube.{name}.channel": getattr(settings.cube, name).channel for name in FACES}
    channels |= {f"cube.{name}": getattr(settings.cube, name) for name in SELF_TESTS}
    for key, channel in channels.items():
        if channel is not None and channel >= count:
            other = "instruments.multiplexer.addresses"
            yield Conflict(key, f"is not among the inputs 0 to {count - 1} that {other} selects", (other,))


def the_enable_line_is_free(settings: Sections) -> Iterator[Conflict]:
    """`instruments.multiplexer.enable_line` is no line that an address uses."""
    multiplexer = settings.instruments.multiplexer
    line = multiplexer.enable_line
    if line is not None and any(address >> line & 1 for address in multiplexer.addresses):
        other = "instruments.multiplexer.addresses"
        yield Conflict("instruments.multiplexer.enable_line", f"is used by {other} as well", (other,))


def the_positioner_reaches_its_limits(settings: Sections) -> Iterator[Conflict]:
    """With positions in mm, each axis' triangle stays between 0 and 180 deg from its low end to its limits."""
    if any(limits_are_ordered(settings)):
        return
    section = "instruments.positioner"
    for key, reason, others in settings.instruments.positioner.conflicts(settings.limits.limits()):
        where = tuple(other[1:] if other.startswith("/") else f"{section}.{other}" for other in others)
        yield Conflict(f"{section}.{key}", reason, where)


def faces_are_distinguishable(settings: Sections) -> Iterator[Conflict]:
    """Sensors of `instruments.cube` differ in line or address, and in serial number; their registers fit together."""
    section = "instruments.cube"
    for key, reason, others in settings.instruments.cube.conflicts():
        yield Conflict(f"{section}.{key}", reason, tuple(f"{section}.{other}" for other in others))


def the_positioner_reaches_night_stow_and_snow(settings: Sections) -> Iterator[Conflict]:
    """Night, stow and snow positions lie in the range that is set for a rotator in `instruments.positioner`."""
    if any(limits_are_ordered(settings)):
        return
    own, safety = settings.instruments.positioner, settings.safety
    equator_deg = equator_azimuth_deg(settings.site.latitude_deg)
    for position in ("night", "stow", "snow"):
        a_deg, b_deg = getattr(safety, f"{position}_a_deg"), getattr(safety, f"{position}_b_deg")
        if position == "snow":
            a_deg, b_deg = settings.limits.limits().clip(a_deg, b_deg)
        if reason := own.unreachable(a_deg, b_deg, equator_deg):
            yield Conflict(f"safety.{position}_b_deg", reason, (f"safety.{position}_a_deg",))


def position_steps_fit_tolerance(settings: Sections) -> Iterator[Conflict]:
    """Wherever inside `limits` the axes are sent, the positioner comes to rest within `motion.tolerance_deg` of it."""
    if any(limits_are_ordered(settings)) or any(the_positioner_reaches_its_limits(settings)):
        return
    tolerance_deg = settings.motion.tolerance_deg
    rests_within = settings.instruments.positioner.rests_within(settings.limits.limits())
    for axis, rests_deg in zip("ab", rests_within, strict=True):
        ends = (f"limits.{axis}_min_deg", f"limits.{axis}_max_deg", f"instruments.positioner.{axis}_axis.low_deg")
        if math.isnan(rests_deg):
            reason = (
                f"leaves no whole position unit up to {ends[1]} to which axis {axis.upper()}, built as"
                f" instruments.positioner.{axis}_axis says, could be sent"
            )
            yield Conflict(ends[0], reason, ends[1:])
        elif rests_deg > tolerance_deg:
            enough_deg = math.ceil(rests_deg * 20) / 20
            reason = (
                f"is too little: because of the positioner's steps, axis {axis.upper()} rests up to {rests_deg:.2f} deg"
                f" from its target; with {enough_deg:g} deg it arrives everywhere"
            )
            yield Conflict("motion.tolerance_deg", reason, ends)


def a_scan_fits_its_period(settings: Sections) -> Iterator[Conflict]:
    """Where a multiplexer reads, all readings of a scan, with settling and conversion, fit into `cube.scan_every_s`."""
    settle_s = settings.instruments.multiplexer.settle_s
    meter = settings.instruments.voltmeter
    readings = len(FACES) + sum(getattr(settings.cube, name) is not None for name in SELF_TESTS)
    conversion_s = _AUTOZERO * meter.nplc / meter.line_frequency_hz
    needed_s = readings * (settle_s + conversion_s)
    if needed_s > settings.cube.scan_every_s:
        yield Conflict(
            "cube.scan_every_s",
            f"is too short for {readings} readings of {settle_s:g} s to settle and {conversion_s:.3g} s to convert:"
            f" they take {needed_s:.3g} s; where another driver reads the faces, name it in instruments.cube.driver",
            (
                "cube.self_test_channel",
                "cube.second_self_test_channel",
                "instruments.multiplexer.settle_s",
                "instruments.voltmeter.nplc",
                "instruments.voltmeter.line_frequency_hz",
            ),
        )


def the_range_reaches_bright_sun(settings: Sections) -> Iterator[Conflict]:
    """Up to 1000 W/m2, each face's voltage stays within 1.2 times `instruments.voltmeter.range_v`, by its gain."""
    largest_mv = _OVER_RANGE * settings.instruments.voltmeter.range_v * 1e3
    for name in FACES:
        face, key = getattr(settings.cube, name), f"cube.{name}.gain_w_m2_per_mv"
        reach_w_m2 = face.gain_w_m2_per_mv * (largest_mv - face.offset_mv)
        if reach_w_m2 < _BRIGHT_SUN_W_M2:
            others = (f"cube.{name}.offset_mv", "instruments.voltmeter.range_v")
            reason = (
                f"lets instruments.voltmeter.range_v ({settings.instruments.voltmeter.range_v:g} V) end at"
                f" {reach_w_m2:.3g} W/m2, below bright sun; is this the sensor's mV per W/m2 instead of its inverse?"
            )
            yield Conflict(key, reason, others)


def averaging_window_is_in_range(settings: Sections) -> Iterator[Conflict]:
    """`windows.mean_s` is at least `cube.scan_every_s` and at most `windows.decide_every_s`."""
    mean_s, scan_s, decide_s = (
        settings.windows.mean_s,
        settings.cube.scan_every_s,
        settings.windows.decide_every_s,
    )
    if mean_s > decide_s:
        other = "windows.decide_every_s"
        yield Conflict("windows.mean_s", f"must not be longer than {other} ({decide_s:g} s)", (other,))
    if mean_s < scan_s:
        other = "cube.scan_every_s"
        yield Conflict("windows.mean_s", f"must not be shorter than {other} ({scan_s:g} s)", (other,))


def simulation_start_is_in_range(settings: Sections) -> Iterator[Conflict]:
    """`simulation.start_utc` is in the years 1979 to 2099."""
    start = settings.simulation.start_utc
    if start is not None and not FIRST_START <= start < END_OF_STARTS:
        years = f"{FIRST_START.year} to {END_OF_STARTS.year - 1}"
        yield Conflict("simulation.start_utc", f"must be in the years {years}: scans cannot carry other times")


def rows_lists_are_complete(settings: Sections) -> Iterator[Conflict]:
    """All lists of `rows` have an item for each tracker, two or more, and the size of the modules is set too."""
    rows = settings.rows
    count = len(rows.east_m)
    for name in ("north_m", "up_m"):
        own = len(getattr(rows, name))
        if own != count and (own or name == "north_m"):
            reason = (
                f"names {pluralise(own, 'tracker')} and rows.east_m names {count}; both must place the same trackers"
            )
            yield Conflict(f"rows.{name}", reason, ("rows.east_m",))
    if count == 1:
        yield Conflict("rows.east_m", "names one tracker; a group has two or more, and a lone tracker needs no [rows]")
    for name in ("module_width_m", "module_height_m"):
        if count and getattr(rows, name) is None:
            yield Conflict("rows.east_m", f"needs rows.{name}, the size of the modules", (f"rows.{name}",))


def trackers_of_a_group_stand_apart(settings: Sections) -> Iterator[Conflict]:
    """No two modules of `rows` can touch: trackers stand further apart than the module's diagonal."""
    rows = settings.rows
    if rows.module_width_m is None or rows.module_height_m is None:
        return
    places = np.array(rows.positions_m).reshape(-1, 3)
    diagonal_m = math.hypot(rows.module_width_m, rows.module_height_m)
    # One by one, because all pairs at once would be large. The first two that stand too near are reported.
    for number, place in enumerate(places[1:], 2):
        apart_m = np.linalg.norm(places[: number - 1] - place, axis=-1)
        other = int(np.argmin(apart_m))
        if apart_m[other] < diagonal_m:
            reason = (
                f"puts the trackers {other + 1} and {number} {apart_m[other]:.3g} m apart, where modules of"
                f" {diagonal_m:.3g} m from corner to corner can collide"
            )
            names = ("north_m", "up_m", "module_width_m", "module_height_m")
            yield Conflict("rows.east_m", reason, tuple(f"rows.{name}" for name in names))
            return


def staleness_spans_two_scans(settings: Sections) -> Iterator[Conflict]:
    """`safety.scan_stale_s` is at least twice `cube.scan_every_s`, so that one lost scan is no alarm."""
    scan_s = settings.cube.scan_every_s
    if settings.safety.scan_stale_s < 2 * scan_s:
        reason = f"must be at least two scans, {2 * scan_s:g} s (cube.scan_every_s is {scan_s:g} s)"
        yield Conflict("safety.scan_stale_s", reason, ("cube.scan_every_s",))


def thresholds_have_hysteresis(settings: Sections) -> Iterator[Conflict]:
    """`safety.night_above_w_m2` is not below `safety.night_below_w_m2`; `release_wind_m_s` is below `stow_wind_m_s`."""
    safety = settings.safety
    if safety.night_above_w_m2 < safety.night_below_w_m2:
        other = "safety.night_below_w_m2"
        reason = f"must not be below {other} ({safety.night_below_w_m2:g} W/m2)"
        yield Conflict("safety.night_above_w_m2", reason, (other,))
    if not safety.release_wind_m_s < safety.stow_wind_m_s:
        other = "safety.stow_wind_m_s"
        reason = f"must be below {other} ({safety.stow_wind_m_s:g} m/s)"
        yield Conflict("safety.release_wind_m_s", reason, (other,))


def a_curve_fits_its_period(settings: Sections) -> Iterator[Conflict]:
    """All points of a curve, each with its settling and 30 ms for two exchanges, fit into `load.period_s`."""
    load = settings.load
    needed_s = load.points * (load.settle_s + _LOAD_EXCHANGES_S) + _SWEEP_ENDS_S
    if load.driver != "none" and needed_s > load.period_s:
        reason = f"is too short for {load.points} points of {load.settle_s:g} s to settle: they take {needed_s:.3g} s"
        yield Conflict("load.period_s", reason, ("load.points", "load.settle_s"))


def a_real_rig_has_no_simulated_load(settings: Sections) -> Iterator[Conflict]:
    """`load.driver = "simulated"` is allowed only with simulated instruments."""
    if settings.load.driver == "simulated" and settings.instruments.kind == "real":
        reason = 'cannot be on a real rig; name the load, or set "none"'
        yield Conflict("load.driver", reason, ("instruments.kind",))


def instruments_have_own_ports(settings: Sections) -> Iterator[Conflict]:
    """Voltmeter, positioner and load of a real rig each have a port of their own or, without one, a VISA name."""
    instruments = settings.instruments
    if instruments.kind != "real":
        return
    meter = instruments.voltmeter
    owners: dict[str, str] = {}
    for part, values in (
        (
            "instruments.voltmeter",
            exclusive_resource(meter.resource, meter.prologix_port) if has_multiplexer(settings) else {},
        ),
        ("instruments.positioner", instruments.positioner.exclusive()),
        ("load", settings.load.exclusive()),
    ):
        for name, value in values.items():
            key = f"{part}.{name}"
            if value is not None and (other := owners.setdefault(canonical_address(value), key)) != key:
                reason = f"is set for {other} already, and only one instrument can hold it; each needs its own"
                yield Conflict(key, reason, (other,))


def the_law_in_the_shadow_is_another(settings: Sections) -> Iterator[Conflict]:
    """`law.shadow`, where it is not empty, is an installed law, and not `law.driver`."""
    law, names = settings.law, [name for name in LAW.names() if name != settings.law.driver]
    if law.shadow and law.shadow not in names:
        yield Conflict("law.shadow", f"is not a law that can run beside {law.driver}; those are {', '.join(names)}")


_MULTIPLEXER_RULES = (
    each_face_has_its_channel,
    each_channel_has_an_address,
    the_enable_line_is_free,
    a_scan_fits_its_period,
    the_range_reaches_bright_sun,
)
RULES = (
    *_MULTIPLEXER_RULES,
    instruments_have_own_ports,
    faces_are_distinguishable,
    averaging_window_is_in_range,
    simulation_start_is_in_range,
    the_law_in_the_shadow_is_another,
    rows_lists_are_complete,
    trackers_of_a_group_stand_apart,
    limits_are_ordered,
    positions_are_inside_limits,
    staleness_spans_two_scans,
    thresholds_have_hysteresis,
    the_positioner_reaches_its_limits,
    the_positioner_reaches_night_stow_and_snow,
    position_steps_fit_tolerance,
    a_curve_fits_its_period,
    a_real_rig_has_no_simulated_load,
    *LINK_RULES,
)
