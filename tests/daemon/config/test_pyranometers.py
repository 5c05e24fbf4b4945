"""Mistakes in the keys of pyranometers on Modbus: one clear sentence each."""

import pytest

from daemon.config.file import ConfigError, load_settings

HEAD = "[instruments.cube]\ndriver = 'modbus-pyranometers'\n"
MISTAKES = {
    "[instruments.cube.south]\naddress = 1": (
        "instruments.cube.south.address = 1: is the address of the east sensor on the same line already;"
        " each sensor needs its own"
    ),
    "make = 'smpp'": (
        'instruments.cube.make = "smpp": must be "smp", "hukseflux", "hukseflux-pv", "apogee", "eko-ms60s",'
        ' "delta-ohm" or "map"; did you mean "smp"?'
    ),
    "line = '/dev/ttyUSB0'": (
        'instruments.cube.line = "/dev/ttyUSB0": must be a serial port whose name outlives a replug, such as'
        ' "/dev/serial/by-id/..." or "COM5", "tcp:192.168.1.40:502" for Modbus TCP, or'
        ' "rtu-over-tcp:192.168.1.40:4001"; not /dev/ttyUSB0, which may be another adapter after the next replug'
    ),
    "[instruments.cube.east]\nserial = 7\n[instruments.cube.west]\nserial = 7": (
        "instruments.cube.west.serial = 7: is the serial number of the east sensor already; look at the two type plates"
    ),
    "make = 'apogee'\n[instruments.cube.east]\nserial = 7": (
        'instruments.cube.east.serial = 7: cannot be checked: a sensor of make "apogee" does not report it;'
        " leave it out"
    ),
    # The map belongs to another face.
    "make = 'apogee'\n[instruments.cube.east]\nserial = 7\n[instruments.cube.zenith]\nmake = 'map'\nserial = 9\n"
    "[instruments.cube.map]\nserial_register = 40": (
        'instruments.cube.east.serial = 7: cannot be checked: a sensor of make "apogee" does not report it;'
        " leave it out"
    ),
    "make = 'map'\n[instruments.cube.map]\nfunction = 5": ("instruments.cube.map.function = 5: must be 3 or 4"),
    "make = 'map'\n[instruments.cube.map]\nregister_number = 65535": (
        "instruments.cube.map.register_number = 65535: is the last register, and float32 takes two"
    ),
    "make = 'map'\n[instruments.cube.map]\nnumber_type = 'double'": (
        'instruments.cube.map.number_type = "double": must be "int16", "uint16", "int32", "uint32" or "float32"'
    ),
    "make = 'map'\n[instruments.cube.map]\nscale = 0.0": (
        "instruments.cube.map.scale = 0.0: makes every irradiance zero; give the factor from the sensor's manual"
    ),
    "make = 'map'\n[instruments.cube.map]\nstatus_register = 300": (
        "instruments.cube.map.status_register = 300: is too far from register 0 to be read with it; at most 60"
        " registers lie between them"
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_the_keys_of_pyranometers_is_refused_in_one_sentence(tmp_path, mistake):
    path = tmp_path / "wrong.toml"
    path.write_text(f"{HEAD}{mistake}\n")
    with pytest.raises(ConfigError) as caught:
        load_settings(path)
    assert caught.value.problems == (MISTAKES[mistake],)
