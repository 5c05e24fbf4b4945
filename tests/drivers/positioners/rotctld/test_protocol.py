"""Commands and replies as bytes."""

import math

import pytest

from drivers.positioners.rotctld.protocol import ReplyStream, command, parse_state

# As rotctld of Hamlib 4.5.4 sends it for its dummy rotator.
STATE = (
    b"dump_state:\nrotctld Protocol Ver: 1\nRotor Model: 1\nMinimum Azimuth: -180.000000\nMaximum Azimuth: 450.000000\n"
    b"Minimum Elevation: 0.000000\nMaximum Elevation: 90.000000\nSouth Zero: 0\nrot_type=AzEl\ndone\nRPRT 0\n"
)


def test_a_command_is_one_line_with_all_its_arguments():
    assert command("set_pos", 180.0, -0.004) == b"+\\set_pos 180.00 -0.00\n"
    assert command("stop") == b"+\\stop\n"


@pytest.mark.parametrize("argument", [math.nan, math.inf, -math.inf])
def test_a_command_with_an_argument_that_is_not_finite_is_refused(argument):
    with pytest.raises(ValueError, match="finite"):
        command("set_pos", 10.0, argument)


def test_replies_are_read_correctly_from_pieces_of_any_size():
    data = b"get_pos:\nAzimuth: 12.50\nElevation: 30.00\nRPRT 0\nset_pos: 500 20\nRPRT -1\nRPRT -8\n" + STATE
    for size in (1, 7, len(data)):
        stream = ReplyStream()
        replies = [reply for at in range(0, len(data), size) for reply in stream.feed(data[at : at + size])]
        position, refused, nameless, state = replies
        assert (position.command, position.number("Azimuth"), position.number("Elevation")) == ("get_pos", 12.5, 30.0)
        assert (refused.command, refused.error, nameless.command, nameless.error) == ("set_pos", 1, "", 8)
        assert parse_state(state) == (1, (-180.0, 450.0), (0.0, 90.0), "AzEl")


def test_blanks_at_the_ends_of_the_lines_of_a_reply_are_ignored():
    (reply,) = ReplyStream().feed(b" get_pos: \r\n Azimuth :  12.50 \r\nElevation:30 \r\nRPRT 0 \r\n")
    assert (reply.command, reply.number("Azimuth"), reply.number("Elevation")) == ("get_pos", 12.5, 30.0)


@pytest.mark.parametrize("text", ["nan", "inf", "", "12,5", "1_2.5"])
def test_a_value_that_is_no_finite_number_is_an_error(text):
    (reply,) = ReplyStream().feed(f"get_pos:\nAzimuth: {text}\nRPRT 0\n".encode())
    with pytest.raises(ValueError, match=f"Azimuth is {text!r}, not a number"):
        reply.number("Azimuth")


def test_a_dump_state_without_a_rotator_kind_is_understood_and_one_without_limits_is_refused():
    (older,) = ReplyStream().feed(STATE.replace(b"South Zero: 0\nrot_type=AzEl\ndone\n", b""))
    assert parse_state(older).kind == ""
    (lacking,) = ReplyStream().feed(STATE.replace(b"Maximum Elevation: 90.000000\n", b""))
    with pytest.raises(ValueError, match="Maximum Elevation is missing"):
        parse_state(lacking)


def test_an_endless_stream_without_a_reply_is_given_up():
    stream = ReplyStream()
    with pytest.raises(ValueError, match="without end"):
        stream.feed(b"HTTP/1.1 200 OK and so on\n" * 1000)
