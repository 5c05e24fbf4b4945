"""What the tests of motion do to the simulated unit behind the service's back."""

from dataclasses import replace

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, encode_command

A_PACKET, B_PACKET, STOP_PACKET = b"$.", b"$2", b"$9s"
TRACKING_OFF_PACKET = encode_command(Field.MODE, wire.TRACKING_OFF)


def drive(bench, field, value):
    """Send a command as another program would."""
    bench.unit.feed(encode_command(field, value), bench.clock.monotonic())


def drive_b(bench, angle_deg):
    drive(bench, Field.B_ANGLE, angle_deg)


def lose(bench, monkeypatch, *starts):
    """Let packets that start so get lost on their way to the unit."""
    feed = bench.unit.feed

    def lossy(data, now):
        if not data.startswith(starts):
            feed(data, now)

    monkeypatch.setattr(bench.unit, "feed", lossy)


def show(bench, **fields):
    """Let telemetry say something that the simulated unit does not say by itself."""
    read = type(bench.positioner).read_telemetry

    async def shown():
        return replace(await read(bench.positioner), **fields)

    bench.positioner.read_telemetry = shown


def alarms(bench):
    return {alarm.name: alarm.text for alarm in bench.tracker.alarms.active}


def speed(bench, seconds):
    """Return how fast the faster axis really turns at present [deg/s], from the truth this long apart."""
    now = bench.clock.monotonic()
    before, after = bench.unit.truth(now), bench.unit.truth(now + seconds)
    return max(abs(after.a_deg - before.a_deg), abs(after.b_deg - before.b_deg)) / seconds
