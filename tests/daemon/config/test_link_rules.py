"""Rules between the keys of the interfaces that others reach."""

import pytest

SERVED = "[sunspec]\nenabled = true\nlisten = '{}'\n[api]\nenabled = {}\nlisten = '{}'\n"


@pytest.mark.parametrize(
    ("sunspec", "api"),
    [
        ("127.0.0.1:5020", "127.0.0.1:5020"),
        ("0.0.0.0:5020", "127.0.0.1:5020"),
        ("192.168.1.20:5020", "0.0.0.0:5020"),
        ("[::]:5020", "[::1]:5020"),
    ],
)
def test_two_servers_of_one_process_on_the_same_port_are_refused(problem, sunspec, api):
    said = problem(SERVED.format(sunspec, "true", api))
    assert said.startswith(f'sunspec.listen = "{sunspec}": is the port of api.listen ({api}) already')


@pytest.mark.parametrize(
    ("sunspec", "served", "api"),
    [
        ("127.0.0.1:5020", "true", "127.0.0.1:5021"),
        ("127.0.0.1:5020", "false", "127.0.0.1:5020"),
        ("192.168.1.20:5020", "true", "127.0.0.1:5020"),
        ("[::]:5020", "true", "0.0.0.0:5020"),
        ("127.0.0.1:0", "true", "127.0.0.1:0"),
    ],
)
def test_two_servers_that_cannot_clash_may_have_the_same_port_number(read, sunspec, served, api):
    assert read(SERVED.format(sunspec, served, api)).sunspec.listen == sunspec


def test_quiet_hours_that_begin_when_they_end_are_refused(problem):
    said = problem('[notify]\nquiet_from = "22:00"\nquiet_until = "22:00"')
    assert said.startswith('notify.quiet_until = "22:00": must differ from notify.quiet_from; leave out both')
