"""The maker's firmware in real time on a pseudo-terminal, and the real driver on its other end."""

import ast
import asyncio
import contextlib
import subprocess
import sys
import time

from drivers.errors import ConnectError, IdentityError, RefusedError
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.link import SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from tests.firmware.peer import BUILD, COUNTS_PER_MM, FIRMWARE
from tests.support import PATIENCE_S

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)


# As the peer's own program, with two differences. Packets are spaced in the unit's own time: if a busy machine delivers
# two late, one is lost, and a parameter with it. And the status need not be cleared after power-up.
_PROGRAM = """
import sys
import time
sys.path.insert(0, sys.argv.pop(1))
from fw import LiveUnit, provision


class Patient(LiveUnit):
    def step(self, ms):
        until_ms = self.state()["ms"] + ms
        while self.state()["ms"] < until_ms:
            time.sleep(0.01)


unit = Patient(sys.argv[1], sys.argv[2])
provision(unit, float(sys.argv[3]), float(sys.argv[4]), clear=sys.argv[5] == "cleared")
print("up", flush=True)
for line in sys.stdin:
    print(*unit.cmd(line.strip()), flush=True)
unit.close()
"""


def command(link, a_deg, b_deg, *, cleared=True, where=FIRMWARE, build=BUILD):
    """Return the command that runs a unit on a pseudo-terminal: it prints "up", and then takes lines of control."""
    begins = "cleared" if cleared else "as after power-up"
    return [sys.executable, "-B", "-c", _PROGRAM, str(where), build, str(link), str(a_deg), str(b_deg), begins]


class LiveFirmware:
    """One unit, whose true place and cable a test can reach."""

    def __init__(self, link, a_deg, b_deg, *, cleared=True):
        self.link = link
        self._process = subprocess.Popen(
            command(link, a_deg, b_deg, cleared=cleared),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        up = self._process.stdout.readline().strip()
        assert up == "up", f"the firmware did not come up: {up!r}"

    def control(self, line):
        """Give one line of control and return the answer."""
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()

    def write_parameter(self, code, text):
        """Write a parameter as the maker's PC program would."""
        self.control("usb " + (b"$%c" % code + text.encode() + b"\r").hex())

    def let_pass(self, seconds):
        """Return when so many seconds of the unit's own time have passed, which takes longer on a busy machine."""
        until_ms = self._ms() + 1000 * seconds
        while self._ms() < until_ms:
            time.sleep(0.05)

    def _ms(self):
        return ast.literal_eval(self.control("state"))["ms"]

    def positions_mm(self):
        """Return where the axes really stand, in mm from their low end switches."""
        return tuple(axis["true"] / COUNTS_PER_MM for axis in ast.literal_eval(self.control("state"))["axes"])

    def pose_deg(self):
        """Return where the axes really stand, in degrees."""
        low_mm = [setup.geometry.low_length_mm for setup in (A, B)]
        return tuple(
            setup.geometry.angle_at_length(low + at)
            for setup, low, at in zip((A, B), low_mm, self.positions_mm(), strict=True)
        )

    def end(self):
        """End the process."""
        self._process.stdin.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


async def taken(order):
    """Give an order, and again until it is taken, as the service does: of two packets read late one is lost."""
    for _ in range(9):
        with contextlib.suppress(RefusedError):
            return await order()
    return await order()


async def move(positioner, a_deg, b_deg, **options):
    """Give a target until it is taken, from standstill each time: an earlier try may have reached one axis."""

    async def order():
        try:
            await positioner.move_to(a_deg, b_deg, **options)
        except RefusedError:
            await positioner.halt()
            raise

    await taken(order)


async def home(positioner, axis):
    """Begin a reference run, however often it has to be asked for."""
    await taken(lambda: positioner.home(axis))


async def clear(positioner, **options):
    """Clear the unit's status until it has taken that, and return the telemetry from before."""
    return await taken(lambda: positioner.clear_faults(**options))


def driver_on(firmware, a=A, b=B, **options):
    """Return the real driver on the firmware's port; a pause of seconds on a busy machine is not a lost link."""
    line = SerialLine(lambda: open_port(str(firmware.link)), time.monotonic, write_s=10.0)
    return PozsolPositioner(line, time.monotonic, a, b, **{"stale_s": 60.0} | options)


async def opened(positioner):
    """Open, and return the identity; again if a busy machine lets the emulator print its screens too slowly."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return await positioner.open()
        except (ConnectError, IdentityError):
            if time.monotonic() >= deadline_s:
                raise


async def until(condition):
    """Wait for a condition that must come true."""
    async with asyncio.timeout(PATIENCE_S):
        done = await condition()
        while not done:
            await asyncio.sleep(0.1)
            done = await condition()


async def standstill_after_s(firmware, begin_s, within_s=10.0):
    """Return how long after `begin_s` the axes really moved last [s], watching for `within_s` at most."""
    before, last_s = firmware.positions_mm(), begin_s
    while time.monotonic() < last_s + 1.0 and time.monotonic() < begin_s + within_s:
        await asyncio.sleep(0.03)
        # In a thread, so that the driver, which lives in this process, is not held up.
        after = await asyncio.to_thread(firmware.positions_mm)
        if after != before:
            before, last_s = after, time.monotonic()
    return last_s - begin_s
