"""Lines in memory: what the drivers of real instruments are given in place of a port to reach simulated ones.

Nothing goes through a thread, and everything waits by the event loop's time, which may be virtual.
"""

from sim_drivers.transports.digital_port import InMemoryPort
from sim_drivers.transports.line import InMemoryLine
from sim_drivers.transports.modbus import InMemoryModbus
from sim_drivers.transports.rotctld_line import InMemoryRotctld
from sim_drivers.transports.stream import InMemoryStream

__all__ = ["InMemoryLine", "InMemoryModbus", "InMemoryPort", "InMemoryRotctld", "InMemoryStream"]
