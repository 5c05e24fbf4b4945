"""The person of a schedule: gives commands, and compares the answers with the truth."""

import asyncio
import math

from daemon.base.records import Mode
from daemon.rigs.campaign.plant import PlantTracker
from daemon.service.operator import CommandError
from daemon.studies.campaign.command_channel import CommandChannel
from daemon.studies.campaign.draw import COMMANDS
from daemon.studies.campaign.watch.target_check import is_at_position, park_positions
from daemon.studies.campaign.watch.truth import TruthWatch

STANDS_DEG = 0.003
WORKING_MODES = (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT)
_WHY = "the campaign"
_LONGEST_SENTENCE = 500
# A stop is sent to the unit first and then kept on disk: a process that dies in between has forgotten it.
_KEPT_WITHIN_S = 0.001


def known_commands(door: CommandChannel) -> list[str]:
    """Return the commands of the campaign that go through a door."""
    return [name for name in COMMANDS if name == "bad" or door.has(name)]


class Person:
    """Gives commands for one tracker to whatever service is there.

    Parameters
    ----------
    mount, watch
        The tracker, and what compares it with the promises.
    door
        Through which commands go.
    """

    def __init__(self, mount: PlantTracker, watch: TruthWatch, door: CommandChannel) -> None:
        self._door = door
        self._mount = mount
        self._watch = watch
        self._commands_given = 0

    async def give(self, name: str, value: tuple[float, ...] = (), for_all: CommandChannel | None = None) -> None:
        """Give a command as soon as a service is there, and check what comes of it.

        `for_all` is the door of one command that is given for all trackers, or None.
        """
        await self._mount.plant.served.wait()
        self._commands_given += 1
        self._watch.storms.note_disturbance(self._now_s)
        if name == "bad" or (name == "goto" and not self._mount.settings.limits.limits().contain(*value)):
            await self._give_wrong(value)
            return
        stopped_before = self._watch.is_stopped and self._now_s > self._watch.stop_asked_s
        maintained_before = self._watch.is_in_maintenance
        self._note_command(name)
        given, mount, watch = self._commands_given, self._mount, self._watch
        generation, asked_s = mount.service, self._now_s
        try:
            answer = await (for_all or self._door).give(mount.service, name, value, self._why(for_all), mount.place)
        except asyncio.CancelledError:
            if self._now_s - asked_s < _KEPT_WITHIN_S:
                self._forget_lost_command(name, was_stopped=stopped_before, was_maintained=maintained_before)
            raise
        except CommandError as error:
            if name == "maintenance" and not maintained_before and "could not be sent" not in str(error):
                watch.note_maintenance_end()
            self._check_sentence(name, str(error), 1 if for_all is None else len(mount.plant.mounts))
            if stopped_before and name not in ("stop", "auto"):
                self._check_refusal(name, str(error))
            return
        if mount.service is not generation:
            return
        if stopped_before and name not in ("stop", "auto") and watch.is_stopped:
            watch.add_violation("stop-undone", f"{name} was carried out under a stop: {answer.text}")
        if answer.done:
            await self._check_done(name, value, answer.text, given)

    @property
    def _now_s(self) -> float:
        return self._mount.clock.monotonic()

    def _why(self, for_all: CommandChannel | None) -> str:
        return f"{_WHY}, to {'all' if for_all else self._mount.name}"

    def check_wishes(self) -> None:
        """See that what persons have asked of other trackers is not in force here."""
        wishes, own = self._mount.control.wishes, [self._why(None), self._why(self._door)]
        for name in type(wishes).model_fields:
            wish = getattr(wishes, name)
            for why in [] if wish is None else [each.why for each in wish.all_requests]:
                if why.startswith(_WHY) and why not in own:
                    self._watch.add_violation(
                        "mixed-up", f"{name} is in force here, and was asked with the words '{why}'"
                    )

    def _note_command(self, name: str) -> None:
        if name == "stop":
            self._watch.note_stop_request()
        elif name == "maintenance":
            self._watch.note_maintenance_start()
        elif name == "auto":
            self._watch.note_stop_release()
            self._watch.note_maintenance_end()
        elif name in ("clear", "home"):
            # From here on a person answers for the count.
            self._watch.count_check.excused = True

    def _forget_lost_command(self, name: str, *, was_stopped: bool, was_maintained: bool) -> None:
        if name == "stop" and not was_stopped:
            self._watch.note_stop_release()
        elif name == "maintenance" and not was_maintained:
            self._watch.note_maintenance_end()

    async def _give_wrong(self, value: tuple[float, ...]) -> None:
        mount, watch = self._mount, self._watch
        orders = watch.active_orders.packets
        wishes = mount.wishes()
        moving = any(watch.moving.values()) or mount.motion.moving
        try:
            answer = await self._door.give(mount.service, "goto", value, self._why(None), mount.place)
        except CommandError as error:
            self._check_sentence("goto", str(error))
        else:
            watch.add_violation("bad-input", f"goto {value} was carried out: {answer.text}")
        if mount.wishes() != wishes or (not moving and watch.active_orders.packets != orders):
            watch.add_violation("bad-input", f"goto {value} changed what was asked before, or sent something")

    def _check_sentence(self, name: str, sentence: str, trackers: int = 1) -> None:
        # A command that all trackers refuse has a line for each tracker behind its own.
        lines = 1 if trackers == 1 else 1 + trackers
        if not sentence or len(sentence.split("\n")) > lines or len(sentence) > _LONGEST_SENTENCE * trackers:
            self._watch.add_violation("sentence", f"{name} is refused with {sentence!r}")

    def _check_refusal(self, name: str, sentence: str) -> None:
        if "auto" not in sentence or not any(latch in sentence for latch in ("stop", "maintenance", "button")):
            self._watch.add_violation("refusal", f"{name} under a stop does not say how it is released: {sentence!r}")

    async def _check_done(self, name: str, value: tuple[float, ...], text: str, given: int) -> None:
        """Compare the answer that a command is done with the truth."""
        if name in ("stop", "hold"):
            await self._check_standing(name, text, given)
        elif name in ("goto", "stow", "snow"):
            self._check_place(name, value, text)
        elif name == "home" and self._mount.motion.homing:
            self._watch.add_violation("false-done", f"home is said to be done while it is under way: {text}")
        elif name == "clear":
            self._check_cleared(text)

    async def _check_standing(self, name: str, text: str, given: int) -> None:
        mount = self._mount
        before, mode = mount.truth(), mount.mode
        await asyncio.sleep(0.1)
        after, undisturbed = mount.truth(), given == self._commands_given and mount.mode is mode
        turned_deg = max(abs(before.a_deg - after.a_deg), abs(before.b_deg - after.b_deg))
        if turned_deg > STANDS_DEG and undisturbed and not self._watch.was_disturbed(0.3):
            self._watch.add_violation("false-done", f"{name} is said to be done, and an axis turns: {text}")

    def _check_place(self, name: str, value: tuple[float, ...], text: str) -> None:
        settings, at = self._mount.settings, self._mount.truth()
        place = value if name == "goto" else park_positions(settings)[Mode(name)]
        if not is_at_position(at, place, settings) and not self._watch.is_wrong() and math.isfinite(sum(place)):
            self._watch.add_violation("false-done", f"{name} is said to be done, the truth is {at}: {text}")

    def _check_cleared(self, text: str) -> None:
        telemetry = self._mount.motion.telemetry
        if telemetry is None or not text.startswith("forgiven"):
            return
        # Behind "; mode" stands the reason for the mode, which may be a fault that has come since.
        forgiven = text.partition("; mode ")[0]
        left = [fault for fault in telemetry.faults if fault in forgiven]
        if left:
            self._watch.add_violation("false-done", f"clear is said to be done with {left}: {text}")
