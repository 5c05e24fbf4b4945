"""Names of hosts in the settings that link the service to the world."""

import pytest

from daemon.config.file import ConfigError, load_settings

KEYS = (
    "archive.database = 'postgresql://{}/db'",
    "notify.heartbeat = 'https://{}/x'",
    "notify.dashboard = 'http://{}'",
)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize(
    ("host", "good"), [("a..b", False), ("a" * 70, False), ("hc.lab:8443", True), ("[::1]", True), ("[::1", False)]
)
def test_a_host_in_an_address_must_have_a_name_that_can_be_looked_up(tmp_path, key, host, good):
    file = tmp_path / "heliocube.toml"
    file.write_text(key.format(host))
    if good:
        load_settings(file)
        return
    with pytest.raises(ConfigError, match=rf"has 1 problem:\n  {key.split()[0]} = "):
        load_settings(file)


@pytest.mark.parametrize(("host", "good"), [("db.plant", True), ("/run/a..b,db.plant", True), ("db..plant", False)])
def test_a_database_address_may_name_hosts_and_files_after_the_database(tmp_path, host, good):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"archive.database = 'postgresql:///db?sslrootcert=/etc/ca.pem&host={host}'")
    if good:
        load_settings(file)
        return
    with pytest.raises(ConfigError, match=r"has 1 problem:\n  archive.database = "):
        load_settings(file)


@pytest.mark.parametrize("host", ["255.255.255.255", "0.0.0.0", "[::]"])
def test_an_address_that_is_not_of_one_machine_is_refused_as_a_target_of_scans(tmp_path, host):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"bridge.send_to = ['192.168.1.20:20571', '{host}:20571']\nbridge.insecure = true")
    with pytest.raises(ConfigError) as refused:
        load_settings(file)
    reason = "must be a numeric address, of one machine and not of all in its network, and a port"
    (problem,) = str(refused.value).splitlines()[1:]
    assert problem.startswith(f'  bridge.send_to[1] = "{host}:20571": {reason}')
