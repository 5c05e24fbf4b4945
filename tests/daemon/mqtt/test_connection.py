"""One connection to a broker, where even its name is not told."""

import asyncio
import socket
import threading

import pytest

from daemon.config.links import MqttSettings
from daemon.mqtt import connection
from daemon.mqtt.connection import Connection


def test_a_name_server_that_does_not_answer_holds_up_no_end(monkeypatch):
    asked, answers = threading.Event(), threading.Event()

    def hangs(*_, **__):
        asked.set()
        answers.wait(30.0)
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    async def scenario():
        opening = asyncio.create_task(
            Connection(MqttSettings(enabled=True, host="broker.lab"), "tracker", None, 1.0).open()
        )
        await asyncio.to_thread(asked.wait, 30.0)
        opening.cancel()
        try:
            done, _ = await asyncio.wait((opening,), timeout=5.0)
            assert done, "it waits for the name server"
        finally:
            answers.set()
        with pytest.raises(asyncio.CancelledError):
            await opening

    monkeypatch.setattr(socket, "getaddrinfo", hangs)
    monkeypatch.setattr(connection, "_DIAL_ENDS_WITHIN_S", 0.1)
    asyncio.run(scenario())
