"""A cube whose driver returns something that is not a reading."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest

from daemon.base.errors import UserError
from daemon.cube.guarded_cube import GuardedCube
from drivers.errors import DeviceError, LinkLostError
from drivers.interfaces import CubeReading, FaceSample

FACE = FaceSample(0.03, 1.7e9, 5.0)
GOOD = CubeReading(FACE, FACE, FACE, FACE, "V")


class Answering:
    """A driver that gives the answer of a test; an error is raised."""

    def __init__(self, answer):
        self.answer = answer

    async def open(self):
        return "a cube"

    async def read(self):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    async def close(self):
        raise KeyError("it cannot be closed")


def read(answer):
    return asyncio.run(GuardedCube(Answering(answer)).read())


@pytest.mark.parametrize(("answer", "words"), [
    (None, "cube: its driver has failed with TypeError: its reading is None, not a CubeReading"),
    (replace(GOOD, unit="mV"), "ValueError: the unit of its reading is 'mV', not one of V, W/m2"),
    (replace(GOOD, west=FACE._replace(value=None)), "TypeError: a face has None, which is not a number"),
    (replace(GOOD, west=FACE._replace(time_utc_s="noon")), "TypeError: a face has 'noon', which is not a number"),
    (replace(GOOD, west=FACE._replace(time_utc_s=math.nan)), "ValueError: the time of a face is nan"),
    (replace(GOOD, west=FACE._replace(time_utc_s=1e300)), r"ValueError: the time of a face is 1e\+300"),
    (replace(GOOD, west=FACE._replace(time_monotonic_s=math.nan)), "ValueError: the time of a face is nan"),
    (replace(GOOD, west=FACE._replace(time_monotonic_s=-math.inf)), "ValueError: the time of a face is -inf"),
    (replace(GOOD, west=FACE._replace(flaw="broken")), "the flaw of a face is 'broken', not one of over-range, late"),
    (KeyError("gauge"), r"cube: its driver has failed with KeyError: 'gauge' \(test_guarded_cube\.py, line \d+\)"),
])  # fmt: skip
def test_an_invalid_reading_or_an_unexpected_error_of_a_cube_driver_is_a_device_error(answer, words):
    with pytest.raises(DeviceError, match=words):
        read(answer)


@pytest.mark.parametrize("error", [LinkLostError("voltmeter", "gone"), UserError("the weather has ended")])
def test_an_error_that_a_cube_driver_may_raise_is_passed_on(error):
    with pytest.raises(type(error), match=str(error)):
        read(error)


def test_a_reading_in_numpy_numbers_is_accepted(caplog):
    good = replace(GOOD, west=FACE._replace(value=np.float32(0.03), flaw="late"))
    assert read(good) is good
    assert asyncio.run(GuardedCube(Answering(GOOD)).open()) == "a cube"
    assert caplog.records == []


def test_a_cube_driver_that_cannot_be_closed_is_logged_once(caplog):
    async def twice():
        cube = GuardedCube(Answering(GOOD))
        await cube.close()
        await cube.close()

    asyncio.run(twice())
    assert [record.message for record in caplog.records] == ["the driver of the cube has failed"]
