"""The simulated instruments in this process, behind the interfaces of real ones.

Each speaks the bytes of its instrument with the instrument's core and waits as long as the instrument takes, by the
event loop's time, whatever that is.
"""

from sim_drivers.transports.cube import InMemoryMultiplexer, InMemoryVoltmeter
from sim_drivers.transports.load import InMemoryLoad
from sim_drivers.transports.positioner import InMemoryPositioner

__all__ = ["InMemoryLoad", "InMemoryMultiplexer", "InMemoryPositioner", "InMemoryVoltmeter"]
