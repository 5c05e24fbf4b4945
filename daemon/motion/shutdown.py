"""The end of the service: it reports that the axes stand only if telemetry has shown it."""

import asyncio

from daemon.base.clock import Clock
from daemon.motion.motion import Motion
from drivers.errors import DeviceError

_LOOK_EVERY_S = 0.05


async def stop_and_confirm(motion: Motion, clock: Clock, within_s: float) -> str | None:
    """Stop for good; return None once telemetry has shown both axes standing, else what is known, in a sentence.

    Parameters
    ----------
    motion
        Its `run` has to go on meanwhile: it repeats the stop, also after the link was lost.
    clock
        The service's time.
    within_s
        How long to wait for the standstill.
    """
    start_s = clock.monotonic()
    motion.freeze_permanently("the service ends")
    unsent = ""
    try:
        async with asyncio.timeout(within_s):
            try:
                await motion.stop()
            except DeviceError as error:
                unsent = f"stop could not be sent ({error})"
                if motion.pose is None or motion.was_at_rest:
                    return _last_known(motion, clock, unsent)
                # A move that was on goes on, and is stopped as soon as the link is back.
            while not _is_standing(motion, start_s):  # noqa: ASYNC110 - telemetry is polled, and no event announces it
                await asyncio.sleep(_LOOK_EVERY_S)
    except TimeoutError:
        sent = "stop was sent, and no telemetry has shown the axes standing since"
        return _last_known(motion, clock, sent if motion.connected else unsent or sent)
    return None


def _is_standing(motion: Motion, start_s: float) -> bool:
    telemetry = motion.telemetry
    if telemetry is None or telemetry.time_monotonic_s < start_s or not motion.is_idle:
        return False
    return motion.stands_since_s is not None


def _last_known(motion: Motion, clock: Clock, text: str) -> str:
    pose = motion.pose
    if pose is None:
        return f"{text}; whether anything moves is not known: look at the tracker"
    age_s = clock.monotonic() - pose.time_monotonic_s
    return f"{text}; last seen {age_s:.0f} s ago at A {pose.a_deg:+z.1f}, B {pose.b_deg:z.1f} deg: look at the tracker"
