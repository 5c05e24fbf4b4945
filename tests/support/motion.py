"""What the tests of motion do to the simulated unit behind the service's back, and how they see what it does."""

import asyncio
from dataclasses import replace

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, encode_command

A_PACKET, B_PACKET, STOP_PACKET = b"$.", b"$2", b"$9s"
CLEAR_PACKET, HOME_A_PACKET = b"$\x88", b"$95"
TRACKING_OFF_PACKET = encode_command(Field.MODE, wire.TRACKING_OFF)


def send_foreign_command(rig, field, value):
    """Send a command as another program would."""
    rig.unit.feed(encode_command(field, value), rig.clock.monotonic())


def send_foreign_b_target(rig, angle_deg):
    send_foreign_command(rig, Field.B_ANGLE, angle_deg)


def lose_packets(rig, monkeypatch, *starts):
    """Lose packets that start so on their way to the unit."""
    feed = rig.unit.feed

    def lossy(data, now):
        if not data.startswith(starts):
            feed(data, now)

    monkeypatch.setattr(rig.unit, "feed", lossy)


def override_telemetry(rig, **fields):
    """Let telemetry say what the simulated unit would not say by itself."""
    read = type(rig.positioner).read_telemetry

    async def shown():
        return replace(await read(rig.positioner), **fields)

    rig.positioner.read_telemetry = shown
    rig.positioner.repeated_s = lambda _seen: None


def alarms(rig):
    return {alarm.name: alarm.text for alarm in rig.tracker.alarms.active}


def speed(rig, seconds):
    """Return how fast the faster axis really turns now [deg/s], from two true poses so many seconds apart."""
    now = rig.clock.monotonic()
    before, after = rig.unit.truth(now), rig.unit.truth(now + seconds)
    return max(abs(after.a_deg - before.a_deg), abs(after.b_deg - before.b_deg)) / seconds


def commands_sent(rig, monkeypatch):
    """Record (time, bytes) of everything that reaches the simulated unit."""
    sent, feed = [], rig.unit.feed
    monkeypatch.setattr(rig.unit, "feed", lambda data, now: (sent.append((now, data)), feed(data, now))[1])
    return sent


def target_packets(sent):
    return [data for _, data in sent if data[:2] in (A_PACKET, B_PACKET)]


async def motion_duration_s(rig, within_s):
    """Return for how long something truly moves from now on [s], looking ten times a second."""
    start, last, before = rig.clock.monotonic(), None, rig.truth()
    while rig.clock.monotonic() - start < within_s:
        await asyncio.sleep(0.1)
        now = rig.truth()
        if now != before:
            last = rig.clock.monotonic()
        before = now
    return 0.0 if last is None else last - start


async def clear_blocking_faults(rig):
    rig.motion.clear_faults(shown=rig.motion.concerns)
    await rig.until(lambda: rig.motion.blocked is None, 20, "the release")
