"""Frames: published bytes, late replies, garbage, and the answering end."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as some

from drivers.modbus.framing import BrokenStreamError, RtuClient, RtuServer, TcpClient, TcpServer, crc16
from drivers.modbus.pdu import (
    ModbusRequest,
    decode_number,
    encode_number,
    exception_text,
    read_registers,
    registers_of,
    write_coil,
    write_register,
    write_registers,
)

# Question, its frame, the reply's frame, the registers in it: from the makers' manuals and captures of others.
PUBLISHED = [
    (
        read_registers(1, 4, 2, 8),
        "01 04 00 02 00 08 50 0C",
        "01 04 10 0001 0000 0000 03E5 03E5 0000 00F8 00EA 66 12",
        (1, 0, 0, 997, 997, 0, 248, 234),
    ),
    (read_registers(1, 4, 26, 2), "01 04 00 1A 00 02 50 0C", "01 04 04 00 09 00 00 2B 86", (9, 0)),
    (
        read_registers(0x40, 3, 0x1000, 4),
        "40 03 10 00 00 04 4F D8",
        "40 03 08 0040 0005 0001 7C4F 79 DA",
        (0x40, 5, 1, 0x7C4F),
    ),
    (read_registers(0x40, 3, 0x1006, 1), "40 03 10 06 00 01 6F DA", "40 03 02 08B1 43 FF", (0x08B1,)),
]


@pytest.mark.parametrize(("request_", "sent", "came", "registers"), PUBLISHED)
def test_rtu_questions_and_replies_match_published_bytes(request_, sent, came, registers):
    framing = RtuClient()
    assert framing.begin(request_) == bytes.fromhex(sent)
    assert registers_of(framing.feed(bytes.fromhex(came))) == registers


@pytest.mark.parametrize("noise", ["03", "03 03", "00 03", "03 00", "03 83"])
def test_a_reply_is_found_behind_bytes_that_look_like_its_beginning(noise):
    framing = RtuClient()
    framing.begin(read_registers(3, 3, 0, 1))
    reply = bytes.fromhex("03 03 02 01 F4")
    assert registers_of(framing.feed(bytes.fromhex(noise) + reply + crc16(reply))) == (500,)


def test_the_rtu_frame_that_writes_a_coil_is_that_of_the_manual():
    framing = RtuClient()
    frame = framing.begin(write_coil(1, 10, on=True))
    assert frame == bytes.fromhex("01 05 00 0A FF 00 AC 38")
    assert framing.feed(frame) is not None


def test_register_values_of_the_manual_are_decoded():
    assert decode_number((1, 0x7C4F), "int32") / 100 == 973.59
    assert decode_number((0xFFFB,), "int16") == -5.0


@given(some.floats(-2e9, 2e9), some.sampled_from(["int32", "float32"]), some.sampled_from(["high-first", "low-first"]))
def test_numbers_encoded_in_registers_are_decoded_to_the_same_numbers(value, kind, order):
    assert decode_number(encode_number(value, kind, order), kind, order) == pytest.approx(value, rel=1e-6, abs=0.5)


def test_nan_and_infinity_in_float_registers_are_decoded_as_nan():
    assert str(decode_number((0x7FC0, 0), "float32")) == "nan"
    assert str(decode_number((0x7F80, 0), "float32")) == "nan"


def rtu(unit, *pdu):
    frame = bytes((unit, *pdu))
    return frame + crc16(frame)


ASKED = read_registers(2, 4, 0, 1)
ANSWER = rtu(2, 4, 2, 0, 7)


@pytest.mark.parametrize(
    "before",
    [
        rtu(1, 4, 2, 0, 9),
        rtu(2, 4, 4, 0, 9, 0, 9),
        rtu(2, 3, 2, 0, 9),
        b"\x00\xff" * 20,
        rtu(2, 4, 2, 0, 9)[:-1] + b"\x00",
        b"\x02\x04\x02\x00",
        # Some adapters hear their own bytes.
        RtuClient().begin(ASKED),
    ],
    ids=["of another device", "of another length", "of another function", "noise", "wrong checksum", "cut off", "echo"],
)
def test_rtu_bytes_that_do_not_belong_to_the_question_are_skipped(before):
    framing = RtuClient()
    framing.begin(ASKED)
    assert framing.feed(before) is None
    assert registers_of(framing.feed(ANSWER)) == (7,)


def test_an_rtu_reply_that_arrives_byte_by_byte_is_found_when_complete():
    framing = RtuClient()
    framing.begin(ASKED)
    replies = [framing.feed(bytes((byte,))) for byte in ANSWER]
    assert replies[:-1] == [None] * (len(ANSWER) - 1)
    assert registers_of(replies[-1]) == (7,)


def test_rtu_bytes_received_before_a_question_are_not_used_for_its_answer():
    framing = RtuClient()
    framing.begin(ASKED)
    framing.feed(ANSWER[:4])
    framing.begin(ASKED)
    assert framing.feed(ANSWER[4:]) is None
    assert framing.feed(ANSWER) is not None


def test_an_rtu_exception_is_taken_as_the_answer():
    framing = RtuClient()
    framing.begin(ASKED)
    reply = framing.feed(rtu(2, 0x84, 2))
    assert exception_text(reply) == "has no such register (exception 2)"


def test_an_rtu_exception_that_is_followed_by_a_byte_of_noise_is_found():
    framing = RtuClient()
    framing.begin(ASKED)
    assert exception_text(framing.feed(rtu(2, 0x84, 2) + bytes(1))) == "has no such register (exception 2)"


def test_over_tcp_a_late_reply_to_an_earlier_question_is_ignored():
    client, server = TcpClient(), TcpServer()
    (late,) = server.feed(client.begin(ASKED), 0.0)
    (second,) = server.feed(client.begin(ASKED), 0.0)
    assert client.feed(server.reply(late, bytes((4, 2, 0, 9)))) is None
    assert registers_of(client.feed(server.reply(second, bytes((4, 2, 0, 7))))) == (7,)


def test_over_tcp_frames_may_be_cut_and_joined_anywhere():
    client, server = TcpClient(), TcpServer()
    (late,) = server.feed(client.begin(ASKED), 0.0)
    (second,) = server.feed(client.begin(ASKED), 0.0)
    stream = server.reply(late, bytes((4, 2, 0, 9))) + server.reply(second, bytes((4, 2, 0, 7)))
    replies = [client.feed(stream[:5]), client.feed(stream[5:14]), client.feed(stream[14:])]
    assert [None if reply is None else registers_of(reply) for reply in replies] == [None, None, (7,)]


@pytest.mark.parametrize("end", [TcpClient(), TcpServer()], ids=["client", "server"])
def test_over_tcp_data_that_is_not_modbus_is_a_broken_stream(end):
    with pytest.raises(BrokenStreamError):
        end.feed(b"GET / HTTP/1.1\r\n", 0.0) if isinstance(end, TcpServer) else end.feed(b"HTTP/1.1 400 Bad\r\n")


@given(some.binary(max_size=60))
def test_an_rtu_server_takes_the_next_question_after_any_noise(noise):
    server = RtuServer()
    server.feed(noise, 0.0)
    (asked,) = server.feed(RtuClient().begin(ASKED), 1.0)
    assert asked.request == ASKED


# Bytes at random hardly ever look like a question, so there is one among them with a flipped bit.
@given(some.integers(0, 63), some.binary(max_size=20), some.binary(max_size=20))
def test_an_rtu_server_takes_no_question_that_has_a_wrong_checksum_whatever_noise_is_around_it(bit, before, after):
    broken = bytearray(RtuClient().begin(ASKED))
    broken[bit // 8] ^= 1 << bit % 8
    noise = before + broken + after
    for asked in RtuServer().feed(noise, 0.0):
        assert rtu(asked.request.unit, *asked.request.pdu) in noise


def test_an_rtu_server_finds_questions_that_arrive_joined_and_split():
    server, client = RtuServer(), RtuClient()
    wanted = [ASKED, write_register(3, 1, 2), write_registers(4, 0, [1, 2, 3])]
    stream = b"".join(client.begin(each) for each in wanted)
    found = server.feed(stream[:11], 100.0) + server.feed(stream[11:], 100.01)
    assert [asked.request for asked in found] == wanted


def test_an_rtu_question_cut_off_a_second_ago_does_not_spoil_the_next_question():
    server, client = RtuServer(), RtuClient()
    server.feed(client.begin(ASKED)[:5], 0.0)
    assert [asked.request for asked in server.feed(client.begin(ASKED), 1.0)] == [ASKED]


ALL_KINDS = [
    *(read_registers(2, function, 0, 1) for function in range(1, 5)),
    write_coil(2, 3, on=False),
    write_register(3, 1, 2),
    ModbusRequest(5, bytes.fromhex("0F 0000 000A 02 0502")),
    write_registers(4, 0, [1, 2, 3]),
    ModbusRequest(6, b"\x2b"),
]


@pytest.mark.parametrize(("client", "server"), [(RtuClient, RtuServer), (TcpClient, TcpServer)])
def test_a_server_finds_questions_byte_by_byte_and_over_rtu_with_a_noise_byte_between_them(client, server):
    asking, answering = client(), server()
    noise = b"\x00" if client is RtuClient else b""
    # Bytes that look like the head of a longer question make the server wait for the rest of it.
    stream = noise.join(asking.begin(each) for each in ALL_KINDS) + 8 * noise
    found = [asked.request for byte in stream for asked in answering.feed(bytes((byte,)), 100.0)]
    assert found == ALL_KINDS


def test_a_pause_of_more_than_0_1_s_ends_an_rtu_frame():
    frame = RtuClient().begin(ASKED)
    for pause_s, whole in ((0.09, True), (0.11, False)):
        server = RtuServer()
        server.feed(frame[:3], 50.0)
        server.feed(frame[3:5], 50.0 + pause_s)
        assert bool(server.feed(frame[5:], 50.0 + 2 * pause_s)) == whole


def test_an_rtu_answer_is_found_after_noise_wherever_it_is_cut():
    for cut in range(len(ANSWER)):
        framing = RtuClient()
        framing.begin(ASKED)
        assert framing.feed(b"\x02\x04" * 400 + ANSWER[:cut]) is None
        assert registers_of(framing.feed(ANSWER[cut:])) == (7,)


def test_a_byte_after_an_rtu_answer_does_not_hide_it():
    framing = RtuClient()
    framing.begin(ASKED)
    assert registers_of(framing.feed(ANSWER + b"\x00")) == (7,)


def test_over_tcp_questions_are_numbered_from_1_to_65535_and_never_0():
    client = TcpClient()
    numbers = [int.from_bytes(client.begin(ASKED)[:2], "big") for _ in range(0x10001)]
    assert numbers == [*range(1, 0x10000), 1, 2]


def test_over_tcp_the_reply_of_another_unit_is_not_taken():
    client, server = TcpClient(), TcpServer()
    (asked,) = server.feed(client.begin(ASKED), 0.0)
    reply = server.reply(asked, bytes((4, 2, 0, 7)))
    assert client.feed(reply[:6] + b"\x03" + reply[7:]) is None
    assert registers_of(client.feed(reply)) == (7,)
    assert client.feed(reply) is None


@pytest.mark.parametrize(
    ("head", "can_be"),
    [
        ("0001 0000 0001 02", False),
        ("0001 0000 0002 02", True),
        ("0001 0000 00FE 02", True),
        ("0001 0000 00FF 02", False),
        ("0001 0001 0002 02", False),
    ],
)
def test_over_tcp_a_wrong_frame_header_is_refused_as_soon_as_it_is_complete(head, can_be):
    server, data = TcpServer(), bytes.fromhex(head)
    assert server.feed(data[:-1], 0.0) == []
    if can_be:
        assert server.feed(data[-1:], 0.0) == []
    else:
        with pytest.raises(BrokenStreamError):
            server.feed(data[-1:], 0.0)


def test_a_read_request_has_its_unit_function_register_and_count():
    assert read_registers(9, 3, 1, 1) == ModbusRequest(9, b"\x03\x00\x01\x00\x01")


@pytest.mark.parametrize("pdu", [b"\x07", b"\x03\x00\x00\x00\x01", b"\x10\x00\x01\x00\x01\x02\x00\x07"])
def test_an_rtu_server_finds_questions_of_every_length_byte_by_byte(pdu):
    server, frame = RtuServer(), rtu(9, *pdu)
    found = [server.feed(bytes((byte,)), 0.0) for byte in frame + frame]
    assert [len(asked) for asked in found] == ([0] * (len(frame) - 1) + [1]) * 2
    assert found[-1][0].request == ModbusRequest(9, pdu)


def test_rtu_noise_is_buffered_only_up_to_a_limit_and_hides_no_answer():
    framing = RtuClient()
    framing.begin(ASKED)
    for _ in range(100):
        assert framing.feed(b"\x55" * 300) is None
    assert len(pickle.dumps(framing)) < 1500
    assert framing.feed(b"\x55" * 300 + ANSWER[:5]) is None
    assert registers_of(framing.feed(ANSWER[5:])) == (7,)
