"""Fixtures: the whole service on the in-process rig under virtual time, with access to every simulated instrument."""

import asyncio
from datetime import UTC, datetime

import pytest

from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop, call_until
from daemon.config.settings import Settings
from daemon.motion.polling import OFTEN, Polling
from daemon.rigs.campaign.rig import KEY, InMemoryRig, ManualWeather
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.service.snapshot import snapshot

__all__ = ["KEY", "SITE", "ManualWeather", "ServiceRig", "run_rig"]

SITE = Settings().site.place()


class ServiceRig(InMemoryRig):
    """The rig, with what tests want to know of it."""

    kept_in = StateFolder
    has_fixed_start_pose = True

    def make_state_folder(self, directory):
        return self.kept_in(directory)

    def take_snapshot(self, recent=None, store=None, links=None):
        """Take a snapshot; `recent` holds the records from the bus, if the test needs them."""
        return snapshot(self.service, RecentRecords() if recent is None else recent, 1.0, store, links or {})

    def records_of(self, kind):
        return [record for record in self.records if isinstance(record, kind)]

    async def until(self, condition, within_s, what, every_s=None):
        """Let time pass until the condition holds, checking it `every_s`, or 2000 times in `within_s`."""
        begun_s, holds = self.clock.monotonic(), False

        def looked():
            nonlocal holds
            holds = condition()
            return holds or self.clock.monotonic() >= begun_s + within_s

        if not looked():
            # A task that sleeps between two checks was half of what these tests computed.
            await call_until(max(0.02, within_s / 2000.0) if every_s is None else every_s, looked)
        assert holds, f"{what} did not happen within {within_s} s; mode {self.mode}"

    async def until_mode(self, mode, within_s):
        await self.until(lambda: self.mode is mode, within_s, f"mode {mode}")


@pytest.fixture
def run_rig():
    """Run a scenario, an async function that is given the rig, with the service running.

    Where hours pass, `rest_look_s` lets a positioner at rest be read less often, if the test does not depend on it.
    """

    def run(
        scenario, *, start="2022-10-12T10:00", weather=None, role=Role.BOTH, setup=None, rest_look_s=None, **sections
    ):
        sections["bridge"] = {"listen": "127.0.0.1:0", "send_to": ()} | sections.get("bridge", {})
        settings = Settings.model_validate(sections)
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            loop = runner.get_loop()
            rig = ServiceRig(
                loop,
                settings,
                datetime.fromisoformat(start).replace(tzinfo=UTC),
                ManualWeather() if weather is None else weather,
                role,
                setup,
                OFTEN if rest_look_s is None else Polling(idle_s=rest_look_s),
            )

            async def beside():
                stop = asyncio.Event()
                serving = asyncio.create_task(rig.service.run(stop))
                acting = asyncio.create_task(scenario(rig))
                await asyncio.wait((serving, acting), return_when=asyncio.FIRST_COMPLETED)
                stop.set()
                outcomes = await asyncio.gather(serving, acting, return_exceptions=True)
                for outcome in reversed(outcomes):
                    if isinstance(outcome, BaseException):
                        raise outcome

            runner.run(beside())
        return rig

    return run
