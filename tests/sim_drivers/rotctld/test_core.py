"""The simulated rotctld beside Hamlib's own, byte by byte."""

import pytest

from sim_drivers.rotctld.core import RotatorCore, RotatorRange, RotctldSession


@pytest.fixture
def session():
    return RotctldSession(RotatorCore(0.0))


@pytest.mark.parametrize(
    "text",
    [
        "p\n",
        "+p\n",
        "+\\get_pos\n",
        "P 0 0\n",
        "+\\set_pos 0.00 0.00\n",
        "\\set_pos 0 0\n",
        "+P 500 20\n",
        "P abc 20\n",
        "P 10\nS\n",
        "+P 10\n+S\n",
        "P 0 0\nS\np\n",
        "+P 0 0\n+S\n+p\n",
        "S\n",
        "+S\n",
        "K\n",
        "+K\n",
        "+R 1\n",
        "zz\n",
        "+\\foo\n",
        "+\\foo\n+p\n",
        "\\dump_state\n",
        "+\\dump_state\n",
        "\n\np\n",
    ],
)
def test_the_simulated_rotctld_answers_each_command_as_the_real_one_does(start_rotctld, session, text):
    real = start_rotctld().ask(text)
    assert session.feed(text.encode(), 0.0) == real


def test_the_simulated_rotctld_reports_and_enforces_its_range_as_the_real_one_does(start_rotctld):
    turns = RotatorRange(azimuth_min_deg=-50.0, azimuth_max_deg=50.0, elevation_min_deg=15.0, elevation_max_deg=80.0)
    session = RotctldSession(RotatorCore(0.0, turns))
    real = start_rotctld("-C", "min_az=-50,max_az=50,min_el=15,max_el=80")
    with real.connect() as peer, peer.makefile("rb") as answers:
        for text in ("+\\dump_state\n", "+P 51 20\n", "+P 0 14\n", "+P 0 81\n"):
            peer.sendall(text.encode())
            simulated = session.feed(text.encode(), 0.0)
            assert answers.read(len(simulated)) == simulated, text


def test_both_axes_turn_at_once_and_stop_where_they_are(session):
    session.feed(b"P 60 30\n", 0.0)
    assert session.feed(b"p\n", 2.0) == b"12.00\n12.00\n"
    assert session.feed(b"S\n", 3.0) == b"RPRT 0\n"
    assert session.feed(b"p\n", 9.0) == b"18.00\n18.00\n"


@pytest.mark.parametrize(
    ("fault", "answers"),
    [
        ("gone", b"RPRT -6\nRPRT -6\nRPRT -6\n"),
        ("deaf", b"RPRT 0\n0.00\n0.00\nRPRT 0\n"),
        ("stopless", b"RPRT 0\n0.00\n0.00\nRPRT -11\n"),
    ],
)
def test_each_fault_of_the_rotator_shows_in_the_answers_of_the_simulated_rotctld(fault, answers):
    core = RotatorCore(0.0)
    core.faults.add(fault)
    assert RotctldSession(core).feed(b"P 60 30\np\nS\n", 0.0) == answers
    assert core.destination()[0] == (60.0 if fault == "stopless" else 0.0)


def test_a_rotator_that_rotctld_cannot_reach_keeps_its_earlier_target():
    core = RotatorCore(0.0)
    session = RotctldSession(core)
    session.feed(b"P 60 30\n", 0.0)
    core.faults.add("gone")
    assert session.feed(b"S\nP 0 0\n", 1.0) == b"RPRT -6\nRPRT -6\n"
    assert core.destination() == (60.0, 30.0)


def test_clients_of_rotctld_share_the_rotator_and_each_has_a_line_buffer_of_its_own():
    core = RotatorCore(0.0)
    one, other = RotctldSession(core), RotctldSession(core)
    assert one.feed(b"+P 1", 0.0) == b""
    assert other.feed(b"+P 5 6\n", 0.0) == b"set_pos: 5 6\nRPRT 0\n"
    assert one.feed(b"0 20\n", 0.0) == b"set_pos: 10 20\nRPRT 0\n"
    assert core.destination() == (10.0, 20.0)
    assert (one.feed(b"q\n", 0.0), one.closed, other.closed) == (b"", True, False)
