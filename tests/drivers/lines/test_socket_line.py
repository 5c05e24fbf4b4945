"""An instrument's socket that does not open."""

import asyncio

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import ConnectError
from drivers.lines.socket_line import SocketLine


def test_who_does_not_answer_is_given_up_after_five_seconds(monkeypatch):
    async def never(*_where, **_keys):
        await asyncio.sleep(3600.0)

    async def opened_for_s():
        loop = asyncio.get_running_loop()
        with pytest.raises(ConnectError, match="5025 does not answer: is it on, and the network"):
            await SocketLine("cube", "10.0.0.9", 5025).open()
        return loop.time()

    monkeypatch.setattr(asyncio, "open_connection", never)
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        begin_s = runner.get_loop().time()
        assert runner.run(opened_for_s()) - begin_s == pytest.approx(5.0)
