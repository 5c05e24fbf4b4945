"""Rules between keys that hold for some processes only, or that refer to a limit of another part."""

import pytest

from daemon.bridge.senml import EARLIEST_UTC_S, LATEST_UTC_S
from daemon.config.stuck_lines import self_test_gaps

REAL = "[instruments]\nkind = 'real'\n"
METER = "[instruments.voltmeter]\nresource = 'ASRL/dev/serial/by-id/usb-FTDI_A50285BI-if00-port0::INSTR'\n"
FAST = "[cube]\nscan_every_s = 1.0\n"
TOO_SHORT = "cube.scan_every_s = 1.0: is too short for 4 readings"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FAST, TOO_SHORT),
        (FAST + REAL + METER, TOO_SHORT),
        ("[instruments.multiplexer]\nsettle_s = 1.3", "cube.scan_every_s = 5.0 (default): is too short for 4 readings"),
    ],
)
def test_a_scan_period_too_short_for_the_multiplexer_is_refused(problem, text, message):
    assert problem(text).startswith(message)


@pytest.mark.parametrize("text", [REAL, "[instruments.cube]\ndriver = 'modbus-pyranometers'\n"])
def test_a_scan_period_too_short_for_a_multiplexer_is_accepted_where_none_reads_the_cube(read, text):
    settings = read(FAST + text)
    assert settings.cube.scan_every_s == 1.0
    assert self_test_gaps(settings) == []


@pytest.mark.parametrize(
    "start", ["0001-01-01T00:00:00+14:00", "1978-12-31T23:59:59Z", "2099-12-31T23:00:00-05:00", "9999-12-31T00:00:00Z"]
)
def test_a_simulation_that_starts_outside_the_years_1979_to_2099_is_refused(problem, start):
    assert "must be in the years 1979 to 2099" in problem(f"[simulation]\nstart_utc = {start}\n")


@pytest.mark.parametrize("start", ["1979-01-01T00:00:00Z", "2099-12-31T23:59:59Z"])
def test_a_simulation_may_start_within_the_years_1979_to_2099(read, start):
    found = read(f"[simulation]\nstart_utc = {start}\n").simulation.start_utc
    assert EARLIEST_UTC_S < found.timestamp() < LATEST_UTC_S


ADAPTERS = [f"/dev/serial/by-id/usb-Prologix-{name}-if00-port0" for name in "AB"]
LOAD = "[load]\ndriver = 'agilent6063b'\nresource = 'GPIB0::5::INSTR'\n"
BEHIND = "prologix_port = '{}'\n"
POSITIONER = "[instruments.positioner]\nport = '{}'\n"
ON_BUS = "[instruments.voltmeter]\nresource = 'GPIB0::5::INSTR'\n"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (ON_BUS + BEHIND.format(ADAPTERS[0]) + LOAD + BEHIND.format(ADAPTERS[0]), "load.prologix_port"),
        (ON_BUS + LOAD, "load.resource"),
        (POSITIONER.format(ADAPTERS[0]) + LOAD + BEHIND.format(ADAPTERS[0]), "load.prologix_port"),
        (POSITIONER.format(ADAPTERS[0]) + LOAD.replace("GPIB0::5", f"ASRL{ADAPTERS[0]}"), "load.resource"),
        (ON_BUS + BEHIND.format(ADAPTERS[0]) + POSITIONER.format(ADAPTERS[0]), "instruments.positioner.port"),
    ],
)
def test_two_instruments_on_the_same_line_are_refused(problem, text, key):
    assert problem(REAL + text).startswith(f"{key} = ")
    assert "already, and only one instrument can hold it; each needs its own" in problem(REAL + text)


@pytest.mark.parametrize(
    "text",
    [
        ON_BUS + BEHIND.format(ADAPTERS[0]) + LOAD + BEHIND.format(ADAPTERS[1]),
        ON_BUS + BEHIND.format(ADAPTERS[0]) + LOAD,
        METER + LOAD,
    ],
)
def test_load_and_voltmeter_behind_adapters_of_their_own_may_have_one_address(read, text):
    assert read(REAL + text).load.driver == "agilent6063b"


SHORT_ARMS = "[instruments.positioner.b_axis]\narm_1_mm = 150.0\narm_2_mm = 150.0\n"
SLEW = "[instruments.positioner]\nposition_unit = 'deg'\n[instruments.positioner.b_axis]\nlow_deg = {}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            SHORT_ARMS,
            "because of the positioner's steps, axis B rests up to 0.93 deg from its target; with 0.95 deg",
        ),
        (
            SLEW.format(13.05),
            "motion.tolerance_deg = 0.8 (default): is too little: because of the positioner's steps, axis B",
        ),
        # Inside the limits, half a unit is less than this everywhere; at the limit itself the error may be more.
        (
            "[limits]\nb_max_deg = 85\n[safety]\nnight_b_deg = 80\nstow_b_deg = 80\n[motion]\ntolerance_deg = 0.4\n",
            "motion.tolerance_deg = 0.4: is too little: because of the positioner's steps, axis B",
        ),
        (
            "[motion]\ntolerance_deg = 0.3\n",
            "motion.tolerance_deg = 0.3: is too little: because of the positioner's steps, axis A",
        ),
        (
            "[instruments.positioner]\ndriver = 'rotctld'\nresolution_deg = 1.0\n",
            "is too little: because of the positioner's steps, axis B rests up to 1.10 deg",
        ),
        (
            "[limits]\nb_min_deg = 89.9\n",
            (
                "limits.b_min_deg = 89.9: leaves no whole position unit up to limits.b_max_deg to which axis B, built"
                " as instruments.positioner.b_axis says,"
            ),
        ),
    ],
)
def test_a_tolerance_or_limit_that_the_steps_of_the_positioner_cannot_meet_is_refused(problem, text, message):
    assert message in problem(text)


# At flat the actuator is nearly retracted, and the low end switch is beyond flat.
LOWERED = "[instruments.positioner.b_axis]\nsense = 'lowers'\napex_deg = 130.0\nlow_deg = {}\n"


def test_an_axis_that_extension_lowers_has_its_low_end_beyond_flat(read, problem):
    assert read(LOWERED.format(93.0)).instruments.positioner.b_axis.low_deg == 93.0
    assert problem(LOWERED.format(193.0)).endswith("low_deg = 193.0: must be a number from -180 to 180 deg")


@pytest.mark.parametrize("text", [SHORT_ARMS + "[motion]\ntolerance_deg = 1.2\n", SLEW.format(13.0)])
def test_a_tolerance_that_suits_the_steps_of_the_positioner_is_accepted(read, text):
    assert read(text).safety.stow_b_deg == 90.0
