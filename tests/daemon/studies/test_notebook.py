"""The studies inside a notebook, whose kernel runs an event loop already."""

import asyncio

import pytest

import heliocube

pytestmark = pytest.mark.slow


def test_a_day_is_simulated_inside_a_running_loop():
    async def cell():
        return heliocube.simulate("2022-10-14T11:00Z", days=0.02, weather="clear", seed=1)

    tables = asyncio.run(cell())
    assert tables["decisions"]["mode"].iloc[-1] == "tracking"


def test_what_is_wrong_is_told_there_too():
    async def cell():
        return heliocube.simulate("2022-10-14", law="none such")

    with pytest.raises(heliocube.UserError, match="none such"):
        asyncio.run(cell())
