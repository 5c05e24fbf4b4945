"""Every scan goes out at once to every target that can be reached, and no target's outage floods the log."""

import asyncio
import errno
import logging
import os
import socket
import sys
from contextlib import contextmanager

import pytest

from daemon.base.addresses import Address, BridgeError, parse_address
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge import senml, signing
from daemon.bridge.sender import BridgeSender
from daemon.config.links import BridgeSettings
from tests.support import PATIENCE_S

KEY = bytes(range(1, 33))


class HandClock:
    """A clock that the test moves."""

    def __init__(self):
        self.now_s = 1000.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return 1665742815.0 + self.now_s


def scan(sequence=0):
    face = FaceReading(100.0, Quality.OK, 1665742815.0, 5000.0)
    return Scan("cube", "session", sequence, 1665742815.0, 5000.0, face, face, face, face)


@contextmanager
def listening(port=0, family=socket.AF_INET, host="127.0.0.1"):
    with socket.socket(family, socket.SOCK_DGRAM) as listener:
        listener.settimeout(PATIENCE_S)
        listener.bind((host, port))
        yield listener


def address_of(listener):
    host, port = listener.getsockname()[:2]
    return str(Address(host, port))


def closed_port():
    with listening() as listener:
        return listener.getsockname()[1]


@contextmanager
def sending(*targets, key=KEY, clock=None, **settings):
    sender = BridgeSender(BridgeSettings(send_to=targets, **settings), key, clock or HandClock())
    asyncio.run(sender.open())
    try:
        yield sender
    finally:
        asyncio.run(sender.close())


def test_a_scan_reaches_every_target_signed_before_send_returns():
    with listening() as first, listening() as second, sending(address_of(first), address_of(second)) as sender:
        sender.send(scan(7))
        for listener in (first, second):
            assert senml.decode(signing.verify(listener.recv(4096), KEY)) == scan(7)
        assert [(target.sent, target.failed) for target in sender.statistics] == [(1, 0), (1, 0)]


def test_without_a_key_a_scan_is_sent_as_an_unsigned_pack():
    with listening() as listener, sending(address_of(listener), key=None, insecure=True) as sender:
        sender.send(scan())
        assert listener.recv(4096) == senml.encode(scan())


def test_a_scan_reaches_an_ipv6_target():
    try:
        with listening(family=socket.AF_INET6, host="::1") as listener, sending(address_of(listener)) as sender:
            sender.send(scan())
            assert signing.verify(listener.recv(4096), KEY)
    except OSError as error:
        pytest.skip(f"there is no IPv6 here: {error}")


def test_targets_that_refuse_or_cannot_be_reached_do_not_stop_the_others(caplog):
    # The kernel itself refuses the broadcast address of a network; loopback has one on every machine with a network.
    with (
        listening() as last,
        sending(f"127.0.0.1:{closed_port()}", "127.255.255.255:20571", address_of(last)) as sender,
    ):
        for sequence in range(5):
            sender.send(scan(sequence))
            assert senml.decode(signing.verify(last.recv(4096), KEY)).sequence == sequence
        refusing, unreachable, good = sender.statistics
    assert (refusing.down, refusing.last_error) == (True, "Connection refused")
    assert (unreachable.down, unreachable.sent, unreachable.failed) == (True, 0, 5)
    assert unreachable.last_error.endswith(
        "; for the broadcast address of a network: name each tracker, or set bridge.multicast_group"
    )
    assert (good.down, good.sent, good.failed, good.last_error) == (False, 5, 0, "")
    assert len(caplog.records) == 2


def test_the_first_scan_after_a_receiver_came_back_arrives():
    port = closed_port()
    with sending(f"127.0.0.1:{port}") as sender:
        for sequence in range(3):
            sender.send(scan(sequence))
        with listening(port) as listener:
            sender.send(scan(3))
            assert senml.decode(signing.verify(listener.recv(4096), KEY)).sequence == 3


# The kernel reports only so many refused datagrams per second, so the tests below provoke few of them.
def test_a_day_of_outage_of_a_target_logs_at_most_20_lines(caplog):
    caplog.set_level(logging.INFO)
    clock = HandClock()
    with sending("127.255.255.255:20571", clock=clock) as sender:
        for _ in range(24 * 60):
            sender.send(scan())
            clock.now_s += 60
    assert {record.levelname for record in caplog.records} == {"WARNING"}
    assert "the way of the scans to 127.255.255.255:20571 is down: " in caplog.messages[0]
    assert len(caplog.records) <= 20


def test_the_end_of_an_outage_of_a_target_is_logged_once_after_ten_minutes_without_an_error(caplog):
    caplog.set_level(logging.INFO)
    clock = HandClock()
    port = closed_port()
    with sending(f"127.0.0.1:{port}", clock=clock) as sender:
        for _ in range(3):
            sender.send(scan())
            clock.now_s += 5
        with listening(port):
            sent_until_told = 0
            for _ in range(60):
                sender.send(scan())
                sent_until_told += len(caplog.records) < 2
                clock.now_s += 30
    down, up = caplog.records
    # The last error comes with one of the first sends: at most 15 s after the outage was found.
    assert sent_until_told == 20, "ten minutes without an error"
    assert up.fields["down_s"] <= 15.0
    assert (down.levelname, up.levelname) == ("WARNING", "INFO")
    assert "Connection refused" in down.getMessage()
    assert up.getMessage() == f"the way of the scans to 127.0.0.1:{port} is back"


def test_a_target_that_comes_and_goes_is_logged_as_one_outage(caplog):
    caplog.set_level(logging.INFO)
    clock = HandClock()
    port = closed_port()
    with sending(f"127.0.0.1:{port}", clock=clock) as sender:
        for _ in range(12):
            for _ in range(2):
                sender.send(scan())
                clock.now_s += 1
            with listening(port):
                for _ in range(5):
                    sender.send(scan())
                    clock.now_s += 60
    assert "is down" in caplog.messages[0]
    assert not [line for line in caplog.messages if "is back" in line]
    assert len(caplog.messages) <= 4


def test_a_sender_with_the_default_settings_and_without_a_key_is_refused():
    with pytest.raises(BridgeError, match=r"bridge\.key_file is not set: make a key"):
        BridgeSender(BridgeSettings(), None, HandClock())


def test_a_sender_without_a_target_is_refused():
    with pytest.raises(BridgeError, match=r"bridge\.send_to is empty and bridge\.multicast_group is not set"):
        BridgeSender(BridgeSettings(send_to=()), KEY, HandClock())


def test_a_multicast_interface_that_this_machine_does_not_have_is_an_outage_not_an_error():
    with sending(multicast_group="239.255.20.71:20571", multicast_interface="192.0.2.1") as sender:
        assert not sender.statistics[0].down
        sender.send(scan())
        assert sender.statistics[0].failed == 1
        assert sender.statistics[0].last_error == os.strerror(errno.EADDRNOTAVAIL)


def test_a_multicast_group_needs_no_interface_setting():
    with sending(multicast_group="239.255.20.71:20571") as sender:
        assert [target.target for target in sender.statistics] == ["239.255.20.71:20571"]


def test_a_sender_that_is_opened_again_sends_again():
    with listening() as listener, sending(address_of(listener)) as sender:
        for number in range(2):
            sender.send(scan(number))
            assert senml.decode(signing.verify(listener.recv(4096), KEY)).sequence == number
            asyncio.run(sender.close())
            asyncio.run(sender.open())
        assert sender.statistics[0].failed == 0


# ip(7), <linux/in.h>: reports the remaining hops (TTL) of each datagram.
IP_RECVTTL = 12


@pytest.mark.skipif(sys.platform != "linux", reason="the option has another number elsewhere")
def test_a_scan_for_the_multicast_group_has_the_ttl_of_the_settings():
    with listening(host="0.0.0.0") as listener:
        membership = socket.inet_aton("239.255.20.71") + socket.inet_aton("127.0.0.1")
        try:
            listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            pytest.skip(f"multicast does not work here: {error}")
        listener.setsockopt(socket.IPPROTO_IP, IP_RECVTTL, 1)
        group = f"239.255.20.71:{listener.getsockname()[1]}"
        with sending(multicast_group=group, multicast_interface="127.0.0.1", multicast_ttl=3) as sender:
            sender.send(scan())
            if sender.statistics[0].failed:
                pytest.skip(f"multicast does not work here: {sender.statistics[0].last_error}")
            _, ((_, _, hops),), _, _ = listener.recvmsg(4096, 64)
        assert int.from_bytes(hops, sys.byteorder) == 3


def test_a_sender_that_is_not_open_does_not_send():
    with pytest.raises(RuntimeError, match="not open"):
        BridgeSender(BridgeSettings(send_to=("127.0.0.1:20571",)), KEY, HandClock()).send(scan())
    with sending("127.0.0.1:20571") as sender:
        pass
    with pytest.raises(RuntimeError, match="not open"):
        sender.send(scan())


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:20571", "127.0.0.1", 20571),
        (" 0.0.0.0:0 ", "0.0.0.0", 0),
        ("[::1]:20571", "::1", 20571),
        ("[FD00:0::20]:65535", "fd00::20", 65535),
    ],
)
def test_an_address_is_read_and_written_back(text, host, port):
    address = parse_address(text)
    assert (address.host, address.port) == (host, port)
    assert parse_address(str(address)) == address


@pytest.mark.parametrize(
    "text",
    [
        *("", "127.0.0.1", ":20571", "127.0.0.1:", "127.0.0.1:65536", "127.0.0.1:-1", "127.0.0.1:٢", "1.2.3.4:5:6"),
        *("localhost:20571", "1.2.3:4", "127.0.0.01:4"),
        *("::1:20571", "[::1]", "[127.0.0.1]:1", "[fe80::1%eth0]:20571"),
    ],
)
def test_a_text_that_is_no_numeric_address_is_refused_in_one_sentence_that_quotes_it(text):
    with pytest.raises(ValueError, match=r"such as 192\.168\.1\.20:20571|highest port") as caught:
        parse_address(text)
    assert repr(text) in str(caught.value)
