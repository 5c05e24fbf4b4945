"""One connection to a broker: a name server that does not answer, messages that are too long."""

import asyncio
import socket
import threading

import pytest

from daemon.config.links import MqttSettings
from daemon.mqtt import connection
from daemon.mqtt.connection import Connection, ConnectionLostError
from tests.support import PATIENCE_S


def test_opening_a_connection_can_be_cancelled_while_the_name_server_does_not_answer(monkeypatch):
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


@pytest.mark.live
@pytest.mark.parametrize("modern", [True, False])
def test_an_mqtt_5_broker_is_told_the_longest_message_and_a_longer_one_is_not_read(modern):
    said = []

    async def broker(reader, writer):
        said.append(await reader.read(4096))
        writer.write(b"\x20\x03\0\0\0" if modern else b"\x20\x02\0\0")
        await reader.read(4096)
        # The head of a message of 256 MiB, and its first 8 MiB.
        writer.write(b"\x30\xff\xff\xff\x7f\0\x01t" + (b"\0" if modern else b""))
        try:
            for _ in range(8):
                writer.write(bytes(1 << 20))
                await writer.drain()
        except ConnectionError:
            pass
        writer.close()

    async def scenario():
        async with asyncio.timeout(PATIENCE_S), await asyncio.start_server(broker, "127.0.0.1", 0) as server:
            settings = MqttSettings(enabled=True, host="127.0.0.1", port=server.sockets[0].getsockname()[1])
            opened = Connection(settings, "tracker", None, 1.0, modern=modern)
            await opened.open()
            with pytest.raises(ConnectionLostError, match="sends a message of 268435455 bytes, and none of more than"):
                await opened.subscribe("t")
            await opened.close()

    asyncio.run(scenario())
    assert (b"\x27" + (1 << 20).to_bytes(4, "big") in said[0]) == modern
