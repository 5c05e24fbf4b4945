"""Self-tests against every stuck address line: what the configuration promises is what a stuck switch shows."""

import asyncio
import itertools
from random import Random

import numpy as np
import pytest

from daemon.base.clock import LoopClock
from daemon.base.records import Quality
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.config.stuck_lines import self_test_gaps
from daemon.cube.acquisition import Acquisition
from daemon.rigs.real import build_multiplexed_cube
from drivers.meters.keithley2000 import Keithley2000
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.transports import InMemoryLine, InMemoryPort
from sim_drivers.voltmeter.core import VoltmeterCore

FACES_MV = {"east": 30.0, "south": 41.0, "west": 6.0, "zenith": 47.0}
BEST = {"east": 0, "south": 1, "west": 2, "zenith": 7}
FIRST = {"east": 0, "south": 1, "west": 2, "zenith": 3}
LINES = list(itertools.product((0, 1, 2), (False, True)))


def settings_of(channels, tests):
    cube = {name: {"channel": channel} for name, channel in channels.items()}
    cube |= dict(zip(("self_test_channel", "second_self_test_channel"), tests, strict=False))
    return Settings.model_validate({"cube": cube})


def qualities(channels, tests, spoil, parallel=()):
    """Return the qualities of two scans through a switch that `spoil` has changed."""
    settings = settings_of(channels, tests)
    volts = {channel: 1e-3 * FACES_MV[name] for name, channel in channels.items()}
    volts |= dict.fromkeys(tests, 0.0) | dict.fromkeys(parallel, 1e-3 * FACES_MV["zenith"])
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        loop = runner.get_loop()
        switch = MultiplexerCore(inputs=lambda channel, _now: volts.get(channel), latency_s=0.0)
        meter = VoltmeterCore(input_voltage=switch.output_voltage, random=np.random.default_rng(1))
        clock = LoopClock(loop.time, 1.7e9)
        multiplexer = NiMultiplexer(InMemoryPort(switch, loop.time))
        voltmeter = Keithley2000(InMemoryLine("voltmeter", meter, loop.time))
        acquisition = Acquisition(
            settings.cube,
            build_multiplexed_cube(settings, clock, multiplexer, voltmeter),
            clock,
            Random(1),
            lambda _scan: None,
            lambda _event: None,
            lambda _utc_s: 30.0,
            simulated=True,
        )

        async def twice():
            await acquisition._open()
            spoil(switch, loop.time())
            return [face.quality for _ in range(2) for face in (await acquisition.scan()).faces]

        return set(runner.run(twice()))


@pytest.mark.parametrize(("bit", "high"), LINES)
def test_with_the_wiring_of_the_manual_the_self_test_detects_every_line_stuck_high_or_low(bit, high):
    seen = qualities(BEST, (3, 4), lambda switch, now: switch.stick(bit, high, now), parallel=(5, 6))
    assert seen == {Quality.SELF_TEST_FAILED}


def test_with_the_wiring_of_the_manual_the_self_test_detects_a_port_without_supply():
    def dead(switch, now):
        for bit in (0, 1, 2):
            switch.stick(bit, True, now)

    assert qualities(BEST, (3, 4), dead, parallel=(5, 6)) == {Quality.SELF_TEST_FAILED}


def test_with_the_wiring_of_the_manual_the_self_test_passes_while_no_line_is_stuck():
    assert qualities(BEST, (3, 4), lambda _switch, _now: None, parallel=(5, 6)) == {Quality.OK}


@pytest.mark.parametrize("test", range(4, 8))
@pytest.mark.parametrize(("bit", "high"), LINES)
def test_one_self_test_input_detects_a_stuck_line_only_if_that_changes_its_own_address(test, bit, high):
    parallel = [channel for channel in range(4, 8) if channel != test]
    seen = qualities(FIRST, (test,), lambda switch, now: switch.stick(bit, high, now), parallel)
    sees = bool(test >> bit & 1) is not high
    assert (Quality.SELF_TEST_FAILED in seen) is sees
    (sentence, *_) = self_test_gaps(settings_of(FIRST, (test,)))
    assert (f"line {bit} stuck {'high' if high else 'low'}" in sentence) is not sees


def test_self_tests_at_the_last_and_the_first_input_are_reported_not_to_detect_a_dead_port():
    middle = {"east": 1, "south": 2, "west": 4, "zenith": 3}
    (sentence, _) = self_test_gaps(settings_of(middle, (7, 0)))
    assert "does not see a port without supply (all lines high)" in sentence


def test_the_configuration_says_which_self_test_or_parallel_wiring_is_missing():
    assert "no self-test" in self_test_gaps(settings_of(FIRST, ()))[0]
    (sentence,) = self_test_gaps(settings_of(BEST, (3, 4)))
    assert "read at input 5, 6: wire it in parallel" in sentence
    full = {"east": 5, "south": 1, "west": 2, "zenith": 7}
    (sentence,) = self_test_gaps(settings_of(full, (3, 4)))
    assert "read at input 0, 6: wire" in sentence
