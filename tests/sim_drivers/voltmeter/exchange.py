"""The questions that tests put to the simulated voltmeter, and how they read its answers."""

import re

import numpy as np

from sim_drivers.voltmeter.core import VoltmeterCore

READING = re.compile(rb"[+-]\d\.\d{8}E[+-]\d\d\n")


def meter(voltage=0.05, **options):
    source = voltage if callable(voltage) else lambda _now: voltage
    return VoltmeterCore(source, np.random.default_rng(7), **options)


def idle(core, now=0.0):
    assert core.feed(b"*RST\n*CLS\n:SENS:VOLT:RANG 1\n", now) == []
    return core


def ask(core, text, now=1.0):
    replies = core.feed(text.encode() + b"\n", now)
    assert len(replies) == 1, f"{text} was not answered"
    return replies[0][1].decode().strip()


def errors(core, now=1000.0):
    found = []
    while (error := ask(core, ":SYST:ERR?", now)) != '0,"No error"':
        found.append(int(error.split(",")[0]))
    return found
