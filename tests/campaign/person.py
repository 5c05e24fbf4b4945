"""The person of a schedule: gives commands, and holds the answers against the truth."""

import asyncio
import math

from daemon.base.records import Mode
from daemon.service.operator import CommandError

ARRIVED_DEG = 1.3
COMMANDS = ("stop", "stow", "hold", "goto", "auto", "home", "clear", "snow", "maintenance", "bad")
_WHY = "the campaign"
_LONGEST_SENTENCE = 500


def known(door):
    """Return the commands of this module that go through a door."""
    return [name for name in COMMANDS if name == "bad" or door.has(name)]


class Person:
    """Gives commands to whatever service is there.

    Parameters
    ----------
    plant, watch
        The rig, and what holds it against the promises.
    door
        Through which commands go; see `tests.campaign.doors`.
    """

    def __init__(self, plant, watch, door):
        self._door = door
        self._plant = plant
        self._watch = watch
        self._given = 0

    async def give(self, name, value=()):
        """Give a command as soon as a service is there and look at what comes of it."""
        await self._plant.served.wait()
        self._given += 1
        if name == "bad":
            await self._give_wrong(value)
            return
        stopped_before = self._watch.stopped and self._now > self._watch.stop_asked_s
        maintained_before = self._watch.maintained
        self._begins(name)
        given, plant, watch = self._given, self._plant, self._watch
        generation = plant.service
        try:
            answer = await self._door.give(plant.service, name, value, _WHY)
        except CommandError as error:
            if name == "maintenance" and not maintained_before and "could not be sent" not in str(error):
                watch.maintenance_ends()
            self._check_sentence(name, str(error))
            if stopped_before and name not in ("stop", "auto"):
                self._check_refusal(name, str(error))
            return
        if plant.service is not generation:
            return
        if stopped_before and name not in ("stop", "auto") and watch.stopped:
            watch.fails("stop-undone", f"{name} was carried out under a stop: {answer.text}")
        if answer.done:
            await self._check_done(name, value, answer.text, given)

    @property
    def _now(self):
        return self._plant.clock.monotonic()

    def _begins(self, name):
        if name == "stop":
            self._watch.stop_is_asked()
        elif name == "maintenance":
            self._watch.maintenance_begins()
        elif name == "auto":
            self._watch.stop_is_released()
            self._watch.maintenance_ends()
        elif name in ("clear", "home"):
            # From here on a person answers for the count.
            self._watch.reference_excused = True

    async def _give_wrong(self, value):
        plant, watch = self._plant, self._watch
        orders = watch.explained.packets
        wishes = plant.wishes()
        moving = any(watch.moving.values()) or plant.motion.moving
        try:
            answer = await self._door.give(plant.service, "goto", value, _WHY)
        except CommandError as error:
            self._check_sentence("goto", str(error))
        else:
            watch.fails("bad-input", f"goto {value} was carried out: {answer.text}")
        if plant.wishes() != wishes or (not moving and watch.explained.packets != orders):
            watch.fails("bad-input", f"goto {value} changed what was asked before, or sent something")

    def _check_sentence(self, name, sentence):
        if not sentence or "\n" in sentence or len(sentence) > _LONGEST_SENTENCE:
            self._watch.fails("sentence", f"{name} is refused with {sentence!r}")

    def _check_refusal(self, name, sentence):
        if "auto" not in sentence or not any(latch in sentence for latch in ("stop", "maintenance", "button")):
            self._watch.fails("refusal", f"{name} under a stop does not say how it is released: {sentence!r}")

    async def _check_done(self, name, value, text, given):
        """Look whether what is said to be done is so, in truth."""
        watch, plant = self._watch, self._plant
        if name in ("stop", "hold"):
            before, mode = plant.truth(), plant.mode
            await asyncio.sleep(0.1)
            after, undisturbed = plant.truth(), given == self._given and plant.mode is mode
            turned_deg = max(abs(before.a_deg - after.a_deg), abs(before.b_deg - after.b_deg))
            if turned_deg > 0.003 and undisturbed and not watch.disturbed(0.3):
                watch.fails("false-done", f"{name} is said to be done, and an axis turns: {text}")
            return
        safety = plant.service.settings.safety
        wanted = {
            "goto": value,
            "stow": (safety.stow_a_deg, safety.stow_b_deg),
            "snow": (getattr(safety, "snow_a_deg", math.nan), getattr(safety, "snow_b_deg", math.nan)),
        }.get(name)
        if wanted is not None and not watch.is_wrong():
            at = plant.truth()
            if not max(abs(at.a_deg - wanted[0]), abs(at.b_deg - wanted[1])) <= ARRIVED_DEG:
                watch.fails("false-done", f"{name} is said to be done, the truth is {at}: {text}")
        elif name == "home" and plant.motion.homing:
            watch.fails("false-done", f"home is said to be done while it is under way: {text}")
        elif name == "clear" and plant.motion.connected:
            forgiven = text.partition("; standing")[0]
            left = [fault for fault in plant.motion.telemetry.faults if fault in forgiven]
            if left and text.startswith("forgiven"):
                watch.fails("false-done", f"clear is said to be done with {left}: {text}")


WORKS = (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT)
