"""`heliocube probe`: how it is told about the instruments."""

import pytest


@pytest.fixture
def config(tmp_path, monkeypatch):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[instruments.positioner]\nport = '{tmp_path}/positioner'\n")
    monkeypatch.setenv("HELIOCUBE_CONFIG", str(file))
    return file


def test_probe_takes_its_configuration_file_from_the_environment(heliocube, config):
    code, _, err = heliocube("probe", "positioner")
    assert (code, f"there is no {config.parent}/positioner" in err) == (2, True)


@pytest.mark.usefixtures("config")
def test_probe_takes_a_given_line_as_modbus_whatever_the_configuration_has(heliocube):
    code, _, err = heliocube("probe", "cube", "--line", "tcp:127.0.0.1:9", "--addresses", "1")
    assert (code, "127.0.0.1 port 9 takes no connection" in err) == (2, True)
