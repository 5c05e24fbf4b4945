"""Simulated sensors on one pair of wires: which questions they hear."""

import pytest

from drivers.modbus.framing import RtuClient, TcpClient, TcpServer
from drivers.modbus.pdu import READ_INPUT_REGISTERS, read_registers
from sim_drivers.modbus.line import DeviceLineCore
from sim_drivers.modbus.pyranometers import SimulatedSmp

# From a question to its reply, which comes in one piece.
REPLY_S = 0.005


def answers_after(pause_s, client, server=None):
    """Return how many replies the other sensor gives to a question that comes so long after the first."""
    line = DeviceLineCore([SimulatedSmp(unit, unit, lambda _now_s: 300.0) for unit in (1, 2)], server)
    frames = [client.begin(read_registers(unit, READ_INPUT_REGISTERS, 0, 7)) for unit in (1, 2)]
    assert len(line.feed(frames[0], 10.0)) == 1
    return len(line.feed(frames[1], 10.0 + pause_s))


@pytest.mark.parametrize(
    ("pause_s", "heard"), [(0.001, 1), (REPLY_S + 0.001, 0), (REPLY_S + 0.029, 0), (REPLY_S + 0.031, 1)]
)
def test_sensors_on_a_serial_line_miss_a_question_that_comes_too_soon_after_a_reply(pause_s, heard):
    assert answers_after(pause_s, RtuClient()) == heard


def test_a_modbus_gateway_on_the_network_keeps_the_pause_between_questions_itself():
    assert answers_after(0.01, TcpClient(), TcpServer()) == 1
