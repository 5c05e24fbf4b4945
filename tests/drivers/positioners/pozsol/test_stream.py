import queue
import threading
import time

import pytest

from drivers.errors import LinkLostError
from drivers.positioners.pozsol.stream import TelemetryReader
from drivers.positioners.pozsol.table import Value
from drivers.positioners.pozsol.wire import Field
from tests.support import PATIENCE_S

AT_ONCE = 0.0


class Wire:
    """A port that gives out the pieces that it is handed, one at a time, and a clock that each piece moves on."""

    def __init__(self):
        self.now_s = 0.0
        self.echo = False
        self.closed = threading.Event()
        self._pieces = queue.Queue()
        self._taken = threading.Semaphore(0)

    def read(self):
        self._taken.release()
        piece = self._pieces.get(timeout=PATIENCE_S)
        if piece is None:
            raise LinkLostError("positioner", "pulled")
        return piece

    def say(self, data, after_s=0.12):
        """Hand over a piece, and wait until the reader asks for the next one."""
        self._taken.acquire()
        self.now_s += after_s
        self._pieces.put(data)
        self._taken.acquire()
        self._taken.release()

    def end(self):
        self._taken.acquire()
        self._pieces.put(None)
        assert self.closed.wait(PATIENCE_S)

    def has_echo(self):
        return self.echo

    def write(self, data):
        raise AssertionError(data)

    def close(self):
        self.closed.set()


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def reader(wire):
    reader = TelemetryReader(wire, lambda: wire.now_s, gather_s=AT_ONCE)
    yield reader
    if reader.lost is None:
        wire.end()
    reader.close()


def angle(text):
    """Return a screen of axis A."""
    return b"$%c%s" % (Field.A_ANGLE, text) + REST


REST = b"$%c1.0000$%c1.0000$" % (Field.A_POSITION, Field.A_DESTINATION)


def test_the_table_keeps_the_newest_value_of_a_field_with_its_time_of_arrival(wire, reader):
    wire.say(angle(b"1.0"))
    wire.say(angle(b"1.5"))
    assert reader.table.get(Field.A_ANGLE) == Value(b"1.5", pytest.approx(0.24), 1.5)
    assert reader.table.get(Field.B_ANGLE) is None


def test_a_screen_that_comes_just_after_opening_is_taken_as_old_and_ignored(wire, reader):
    wire.say(angle(b"1.0"), after_s=0.05)
    assert (reader.heard, reader.table.get(Field.A_ANGLE)) == (False, None)


@pytest.mark.parametrize("text", [b"", b".", b"-", b"nan", b"inf", b"1e1", b"--1.0", b"1.0x", b"1.0.0", b"361.0"])
def test_an_angle_that_is_not_a_possible_number_is_dropped(wire, reader, text):
    wire.say(angle(b"2.0"))
    wire.say(angle(text))
    assert reader.table.get(Field.A_ANGLE).text == b"2.0"


@pytest.mark.parametrize("text", [b"1x0", b"70.0"])
def test_the_position_beside_an_angle_that_is_not_believed_is_not_believed_either(wire, reader, text):
    wire.say(angle(b"2.0"))
    wire.say(angle(text).replace(b"1.0000", b"9.0000"))
    assert reader.table.get(Field.A_POSITION).text == b"1.0000"
    wire.say(angle(b"2.0").replace(b"1.0000", b"1.5000"))
    assert reader.table.get(Field.A_POSITION).text == b"1.5000"


def test_new_values_of_an_axis_appear_only_once_its_screen_is_complete(wire, reader):
    wire.say(angle(b"2.0"))
    new = angle(b"2.5").replace(b"1.0000", b"1.5000")
    for byte in new[:-1]:
        wire.say(bytes((byte,)), after_s=0.001)
        assert reader.table.get(Field.A_ANGLE).text == b"2.0"
    wire.say(new[-1:], after_s=0.001)
    assert [value.text for value in reader.table.snapshot().values()] == [b"2.5", b"1.5000", b"1.5000"]


def test_one_impossible_angle_is_dropped_and_a_confirmed_one_is_a_jump(wire, reader):
    for text in (b"10.0", b"90.0", b"10.1"):
        wire.say(angle(text))
        assert reader.table.get(Field.A_ANGLE).text != b"90.0"
    assert reader.table.jumped_s is None
    for text in (b"-52.0", b"-52.0"):
        wire.say(angle(text))
    assert reader.table.get(Field.A_ANGLE).text == b"-52.0"
    assert reader.table.jumped_s == wire.now_s


def test_any_angle_is_accepted_without_a_jump_after_a_gap_in_the_telemetry(wire, reader):
    wire.say(angle(b"10.0"))
    wire.say(angle(b"40.0"), after_s=5.0)
    assert (reader.table.get(Field.A_ANGLE).text, reader.table.jumped_s) == (b"40.0", None)


def test_an_angle_that_an_axis_can_reach_while_nothing_is_read_is_not_a_jump(wire, reader):
    wire.say(angle(b"10.0"))
    # The first piece is read late and shows a moment in between; then screens are missing for want of room.
    for text, after_s in ((b"11.0", 0.9), (b"15.0", 0.02), (b"15.1", 0.02)):
        wire.say(angle(text), after_s=after_s)
    assert (reader.table.get(Field.A_ANGLE).text, reader.table.jumped_s) == (b"15.1", None)
    for text, after_s in ((b"15.2", 0.09),) * 8 + ((b"20.0", 0.02), (b"20.0", 0.02)):
        wire.say(angle(text), after_s=after_s)
    assert reader.table.jumped_s == wire.now_s


class Resting:
    """A unit at rest whose screens come as fast as they are read, each 20 ms after the last by its clock."""

    def __init__(self, unread_s=20.0):
        self.now_s = 0.0
        self.begun, self.woken = threading.Event(), threading.Event()
        self._ends_s = unread_s

    def read(self):
        self.now_s += 0.02
        if self.now_s > self._ends_s:
            raise LinkLostError("positioner", "read all the time")
        if self.now_s > 0.9:
            self.begun.set()
        if self.now_s > 8.0:
            self.woken.set()
        return REST

    def has_echo(self):
        return False

    def close(self):
        pass


def test_screens_are_gathered_until_a_command_is_sent():
    unit = Resting()
    reader = TelemetryReader(unit, lambda: unit.now_s, gather_s=60.0)
    assert unit.begun.wait(PATIENCE_S), "its first second is read as it comes"
    assert not unit.woken.wait(0.05), "nobody has attended"
    (thread,) = (each for each in threading.enumerate() if each.name == "heliocube-positioner-reader")
    for _ in range(20_000):
        if unit.woken.wait(0.001):
            break
        # Each command keeps the reader from gathering for a second of the unit's clock.
        reader.read_promptly()
    else:
        pytest.fail("a command does not end the gathering")
    reader.close()
    assert reader.lost is None
    assert reader.table.get(Field.A_POSITION).time_s == unit.now_s
    assert thread.daemon, "a port that hangs does not keep the process from ending"


class StoodStill(Resting):
    """A port on which old screens wait because nobody has read it for some time."""

    def __init__(self):
        super().__init__()
        old = angle(b"2.0") * 300
        self._waiting = [old[at : at + 4095] for at in range(0, len(old), 4095)] + [angle(b"3.0")]

    def read(self):
        screens = super().read()
        # During its first second, screens are read as they come.
        return self._waiting.pop(0) if self.now_s > 1.0 and self._waiting else screens


def test_a_backlog_in_the_port_is_read_at_once_without_gathering():
    unit = StoodStill()
    reader = TelemetryReader(unit, lambda: unit.now_s, gather_s=60.0)
    assert unit.begun.wait(PATIENCE_S)
    for _ in range(2_000):
        if reader.table.get(Field.A_ANGLE) is not None and reader.table.get(Field.A_ANGLE).text == b"3.0":
            break
        time.sleep(0.001)
    else:
        pytest.fail("the newest screen is not read")
    reader.close()


def test_a_lost_port_and_an_echo_end_the_telemetry_reader_with_a_reason(wire, reader):
    wire.end()
    reader.close()
    assert reader.lost == "pulled"
    other = Wire()
    other.echo = True
    echoing = TelemetryReader(other, lambda: other.now_s)
    other._pieces.put(b"")
    assert other.closed.wait(PATIENCE_S)
    echoing.close()
    assert "echo" in echoing.lost


BANNER = b"\r\nready to go\r\n"


@pytest.fixture
def booting(wire):
    """Return a reader of a unit that may restart within two seconds because its port was opened."""
    reader = TelemetryReader(wire, lambda: wire.now_s, boot_s=2.0, banner=b"ready to go", gather_s=AT_ONCE)
    yield reader
    wire.end()
    reader.close()


def test_telemetry_before_the_banner_of_a_restart_is_ignored(wire, booting):
    wire.say(angle(b"1.0"), after_s=0.5)
    assert (booting.heard, booting.restarted_s) == (False, None)
    wire.say(BANNER + angle(b"2.0"), after_s=0.5)
    assert (booting.table.get(Field.A_ANGLE).text, booting.restarted_s) == (b"2.0", 1.0)


def test_telemetry_without_a_banner_is_ignored_until_the_boot_time_is_over(wire, booting):
    wire.say(angle(b"1.0"), after_s=1.9)
    assert not booting.heard
    wire.say(angle(b"1.0"), after_s=0.2)
    assert (booting.heard, booting.restarted_s) == (True, None)


@pytest.mark.parametrize("length", [1, 2, 5, 11, 40])
def test_a_restart_banner_in_any_pieces_clears_all_known_values(wire, booting, length):
    wire.say(angle(b"1.0"), after_s=2.5)
    text = b"$8Micro tracking" + BANNER + b"$,"
    for start in range(0, len(text), length):
        wire.say(text[start : start + length])
    assert booting.restarted_s is not None
    assert booting.table.snapshot() == {}
    wire.say(b"3.0" + REST)
    assert booting.table.get(Field.A_ANGLE).text == b"3.0"
