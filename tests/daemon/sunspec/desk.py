"""A control room on the rig under virtual time."""

from daemon.service.operator_commands import Operators
from daemon.service.recent import RecentRecords
from daemon.sunspec.models import BASE
from daemon.sunspec.server import SunSpecServer
from drivers.modbus.framing import ReceivedRequest
from drivers.modbus.pdu import read_registers, registers_of, write_registers
from tests.support.phases import wait_for_rest, wait_for_tracking

UNIT = 1


def int32(value):
    return [value >> 16 & 0xFFFF, value & 0xFFFF]


class Control:
    """A control room that asks the server without a socket."""

    def __init__(self, rig, *, manual=True):
        settings = rig.service.settings
        own = settings.sunspec.model_copy(update={"enabled": True, "manual": manual})
        settings = settings.model_copy(update={"sunspec": own})
        operators = Operators(rig.service.trackers, 1.0)
        self.recent = RecentRecords()
        rig.bus.subscribe(self.recent.note)
        self.take_snapshot = lambda: rig.take_snapshot(self.recent)
        self.server = SunSpecServer(
            settings, self.take_snapshot, operators, rig.clock, rig.service.cube_alarms.set, 1.0
        )

    async def ask(self, request):
        return await self.server._answer(ReceivedRequest(request), "127.0.0.1")

    async def read(self, register, count):
        return registers_of(await self.ask(read_registers(UNIT, 3, register, count)))

    async def models(self):
        """Return the points of every model by its number, and where it begins."""
        found, at = {}, BASE + 2
        assert await self.read(BASE, 2) == (0x5375, 0x6E53)
        while (head := await self.read(at, 2))[0] != 0xFFFF:
            found[head[0]] = (at, await self.read(at + 2, head[1]))
            at += 2 + head[1]
        return found

    async def write(self, register, values):
        """Return 0, or the code of the exception."""
        reply = await self.ask(write_registers(UNIT, register, values))
        return reply[1] if reply[0] & 0x80 else 0


def on_rig(run_rig, scenario, *, manual=True, **options):
    async def beside(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        control = Control(rig, manual=manual)
        try:
            await scenario(rig, control)
        finally:
            await control.server._end(None)

    return run_rig(beside, **options)
