"""One connection to the broker. Only this module depends on the internals of aiomqtt."""

import asyncio
import contextlib
import logging
import math
import select
import socket
import ssl
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Coroutine
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from daemon.config.links import MqttSettings
from daemon.mqtt.credentials import load_user, tls_context
from daemon.mqtt.outbox import Message

T = TypeVar("T")

_CONNECT_S = 3.0
_CONFIRM_S = 5.0
_LEAVE_S = 1.0
# A name server that does not answer holds up a look-up for longer than a service may take to end.
_DIAL_ENDS_WITHIN_S = 5.0
_FIRST_FAILURE_CODE = 128
_OTHER_VERSION = 132
# The library drops messages above this number. A TLS record, which is read at one go, holds some hundreds of the
# shortest ones.
_MOST_INCOMING = 4096
# The longest packet that is read. Commands and readings of sensors are far shorter, and pages of records are shorter. A
# packet of 256 MiB would hold everything up for seconds.
_LONGEST_INCOMING_BYTES = 1 << 20
# Room for the topic, and for what else a packet has besides the payload.
_OVERHEAD_BYTES = 512

# Our own sentences report what the library would log.
_library_log = logging.getLogger("heliocube.mqtt.library")
_library_log.setLevel(logging.CRITICAL + 1)


class ConnectionLostError(Exception):
    """There is no connection any more, or none came about; the message is one sentence."""


class VersionRefusedError(ConnectionLostError):
    """The broker does not speak the version of MQTT that this connection uses."""


@dataclass(frozen=True, slots=True)
class Incoming:
    """A message from the broker.

    Attributes
    ----------
    retained
        The broker has kept it for later subscribers.
    overdue
        It was read after the broker had ended the connection: this process, or its machine, stood still meanwhile.
    """

    topic: str
    payload: bytes
    retained: bool
    overdue: bool = False

    @property
    def of_unknown_age(self) -> bool:
        """Whether it may have been published long before."""
        return self.retained or self.overdue


class Connection:
    """One connection, used once.

    Parameters
    ----------
    settings
        Where the broker is and how it is spoken to.
    client_id
        Under which name.
    will
        What the broker publishes when this connection ends without a word; None for nothing.
    speed
        The event loop's clock runs this many times as fast as the machine's, which is the broker's.
    modern
        Speak MQTT 5; otherwise 3.1.1.
    """

    def __init__(
        self, settings: MqttSettings, client_id: str, will: Message | None, speed: float, *, modern: bool = True
    ) -> None:
        self._is_mqtt5 = modern
        self._client = _Client(
            settings.host,
            settings.port,
            identifier=client_id,
            will=None if will is None else aiomqtt.Will(will.topic, will.payload, will.qos, will.retain),
            keepalive=settings.keepalive_s,
            timeout=_CONFIRM_S * speed,
            protocol=aiomqtt.ProtocolVersion.V5 if modern else aiomqtt.ProtocolVersion.V311,
            # With MQTT 5 the library begins a new session at a client's first connection, and this client has no other.
            clean_session=None if modern else True,
            properties=_connect_properties() if modern else None,
            max_queued_incoming_messages=_MOST_INCOMING,
            logger=_library_log,
        )
        self._client.settings = settings
        self._speed = speed
        self._place = f"{settings.host}:{settings.port}"

    async def open(self) -> None:
        """Connect; a cancellation waits for the end of a dial that is under way, for 5 s at most.

        Raises
        ------
        ConnectionLostError
            Why that was not possible; `VersionRefusedError` where the broker speaks MQTT 3.1.1 only.
        CredentialsError
            A file cannot be used.
        """
        opening = asyncio.ensure_future(self._client.__aenter__())
        try:
            await asyncio.shield(opening)
        except BaseException as error:
            await self._client.abandon(opening)
            if isinstance(error, aiomqtt.MqttCodeError) and _code(error.rc) == _OTHER_VERSION and self._is_mqtt5:
                raise VersionRefusedError(f"{self._place} does not speak MQTT 5") from None
            if isinstance(error, aiomqtt.MqttError):
                raise ConnectionLostError(self._reason(error)) from None
            raise

    @property
    def most_bytes(self) -> float:
        """How long a payload may be, as far as the broker says."""
        return self._client.most_bytes - _OVERHEAD_BYTES

    async def publish(self, message: Message) -> None:
        """Send a message and wait until it is on its way (QoS 0) or confirmed (QoS 1)."""
        try:
            await self._client.publish(message.topic, message.payload, message.qos, message.retain)
        except aiomqtt.MqttError as error:
            raise ConnectionLostError(self._reason(error)) from None

    async def subscribe(self, topic: str, *, as_published: bool = False) -> bool:
        """Ask for a topic; return whether the broker grants it.

        With `as_published` a message that is published as retained from now on comes marked so, if this is MQTT 5.
        """
        try:
            if self._is_mqtt5:
                options = SubscribeOptions(qos=1, retainAsPublished=as_published)
                granted = await self._client.subscribe(topic, options=options)
            else:
                granted = await self._client.subscribe(topic, qos=1)
        except aiomqtt.MqttError as error:
            raise ConnectionLostError(self._reason(error)) from None
        return all(_code(code) < _FIRST_FAILURE_CODE for code in granted)

    async def incoming(self) -> AsyncIterator[Incoming]:
        """Yield what comes in, until the connection is lost."""
        try:
            async for first in self._client.messages:
                # All that have come are taken at once. To wait for each would take longer than the next ones need to
                # come, and the queue would overflow.
                overdue = self._client.is_given_up
                for message in (first, *self._client.waiting()):
                    payload = message.payload if isinstance(message.payload, bytes) else b""
                    yield Incoming(message.topic.value, payload, message.retain, overdue)
        except aiomqtt.MqttError as error:
            raise ConnectionLostError(self._reason(error)) from None

    async def close(self) -> None:
        """Disconnect in good order if that is still possible, and release everything. Never raises."""
        with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
            async with asyncio.timeout(_LEAVE_S * self._speed):
                await self._client.__aexit__(None, None, None)
        await self._client.abandon(None)

    def _reason(self, error: aiomqtt.MqttError) -> str:
        if self._client.refusal is not None:
            return self._client.refusal
        cause = self._client.ending or error
        if isinstance(cause, aiomqtt.MqttError) and not isinstance(cause, aiomqtt.MqttCodeError):
            return f"{self._place} does not answer"
        ended = (
            f"ended the connection; if that repeats, another client has the client id {self._client.identifier}, or a"
            " message was too long for the broker"
        )
        return f"{self._place} {_REFUSALS.get(_code(getattr(cause, 'rc', None)), ended)}"


def _connect_properties() -> Properties:
    """Return what a broker of MQTT 5 is told about the longest packet: it leaves out longer ones by itself."""
    told = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    told.MaximumPacketSize = _LONGEST_INCOMING_BYTES
    return told


# OpenSSL's numbers for the reasons to refuse a certificate (x509_vfy.h).
_OUT_OF_DATE, _OTHER_NAME = (9, 10), (62, 64)
# The codes by which a broker says why it does not want a connection.
_REFUSALS = {
    133: "refuses the client id: see mqtt.client_id",
    134: "refuses user or password: see mqtt.credentials_file",
    135: "refuses user or password: see mqtt.credentials_file",
    136: "is not available now",
    141: "does not answer any more",
    154: "keeps no retained messages, and the service needs them: allow them in the broker's settings",
    155: "takes no messages of QoS 1, and the service needs them: allow them in the broker's settings",
}


def _code(answer: object) -> int:
    value = getattr(answer, "value", answer)
    return value if isinstance(value, int) else 0


class _TlsSocket(ssl.SSLSocket):
    """A socket that closes itself if the TLS handshake fails: the library then forgets the socket."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise


def _wrong_certificate(error: ssl.SSLCertVerificationError) -> str:
    """Return what is wrong with the broker's certificate, in words that lead to its remedy."""
    if error.verify_code in _OUT_OF_DATE:
        what = "a certificate that is out of date by this machine's clock"
    elif error.verify_code in _OTHER_NAME:
        what = "a certificate for another name than mqtt.host"
    else:
        what = "a certificate that mqtt.ca_file does not confirm"
    return f"{what}: {error.verify_message}"


class _Client(aiomqtt.Client):
    """The library's client with its two gaps filled: a bounded dial, and nothing left behind after a failure."""

    settings: MqttSettings
    refusal: str | None = None
    dialled = False
    most_bytes: float = math.inf

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        self._library_recv = self._client._sock_recv  # noqa: SLF001 - the library asks here for what is left of a packet
        self._client._sock_recv = self._receive_short  # type: ignore[assignment,method-assign]  # noqa: SLF001

    def _receive_short(self, left_bytes: int) -> bytes:
        """Return what has come of a packet; for one that is too long raise `OSError`, which ends the connection."""
        if left_bytes > _LONGEST_INCOMING_BYTES:
            place = f"{self.settings.host}:{self.settings.port}"
            longer = f"none of more than {_LONGEST_INCOMING_BYTES} is read: who publishes it?"
            self.refusal = f"{place} sends a message of {left_bytes} bytes, and {longer}"
            raise OSError(self.refusal)
        return self._library_recv(left_bytes)

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        # A broker of MQTT 3.1.1 sends no properties, and most others do not send this one.
        self.most_bytes = getattr(properties, "MaximumPacketSize", math.inf)
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _client_connect(self) -> None:
        """Dial, in a thread: files may be read here, and names looked up."""
        settings, place = self.settings, f"{self.settings.host}:{self.settings.port}"
        self._client.connect_timeout = _CONNECT_S
        if settings.credentials_file is not None:
            self._client.username_pw_set(*load_user(settings.credentials_file))
        if settings.tls:
            context = tls_context(settings)
            context.sslsocket_class = _TlsSocket
            self._client.tls_set_context(context)
        try:
            super()._client_connect()
        except ssl.SSLCertVerificationError as error:
            self.refusal = f"{place} has {_wrong_certificate(error)}"
            raise
        except ssl.SSLError as error:
            self.refusal = f"{place} cannot be reached with TLS: {error.reason or 'no reason given'}; see mqtt.tls"
            raise
        except socket.gaierror:
            self.refusal = f"mqtt.host: the name {settings.host} cannot be resolved"
            raise
        except ConnectionRefusedError:
            self.refusal = f"nothing listens at {place}"
            raise
        except OSError as error:
            self.refusal = f"{place} cannot be reached: {error.strerror or 'no answer in time'}"
            raise
        finally:
            self.dialled = True

    @property
    def is_given_up(self) -> bool:
        """Whether the broker has ended the connection, even if messages that came before are not read yet."""
        opened = self._client.socket()
        if opened is None or sys.platform != "linux":
            return opened is None
        ended = select.poll()
        ended.register(opened, select.POLLRDHUP)
        return bool(ended.poll(0))

    def waiting(self) -> list[aiomqtt.Message]:
        """Return the messages that have come and were not taken yet, without waiting."""
        return [self._queue.get_nowait() for _ in range(self._queue.qsize())]

    @property
    def ending(self) -> BaseException | None:
        """What ended the connection, or None."""
        ended = self._disconnected.done() and not self._disconnected.cancelled()
        return self._disconnected.exception() if ended else None

    async def _wait_for(self, fut: Awaitable[T], timeout: float | None) -> T:  # noqa: ASYNC109 - the library's name
        """Wait like the library, but not for a connection that is gone, and never swallow a cancellation.

        `asyncio.wait_for` of Python 3.11 may do that.
        """
        waiting = asyncio.ensure_future(fut)
        try:
            await asyncio.wait(
                (waiting, self._disconnected),
                timeout=self.timeout if timeout is None else timeout,
                return_when=asyncio.FIRST_COMPLETED,
            )
            if waiting.done():
                return waiting.result()
            if self._disconnected.done():
                raise aiomqtt.MqttCodeError(None, "disconnected")
            raise aiomqtt.MqttError("no answer in time")
        finally:
            waiting.cancel()

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:  # noqa: ARG002 - paho's
        """Register a socket to be written to, unless it has been closed by the time that this can be done."""

        def register() -> None:
            if sock.fileno() >= 0:
                self._loop.add_writer(sock.fileno(), self._write)

        self._loop.call_soon_threadsafe(register)

    def _write(self) -> None:
        try:
            self._client.loop_write()
        except (OSError, ValueError) as error:
            if not self._disconnected.done():
                self._disconnected.set_exception(error)

    async def abandon(self, opening: "asyncio.Task[Self] | None") -> None:
        """Close the socket if it is still open, and retrieve errors that nobody has asked for."""
        if opening is not None:
            until_s = time.monotonic() + _DIAL_ENDS_WITHIN_S
            while not (opening.done() or self.dialled) and time.monotonic() < until_s:
                await asyncio.wait((opening,), timeout=0.05)
            opening.cancel()
            with contextlib.suppress(Exception, asyncio.CancelledError):
                await opening
        # The thread has asked the loop to register the socket, which happens at the loop's next turn.
        await asyncio.sleep(0)
        if self._client.socket() is not None:
            self._client._sock_close()  # noqa: SLF001 - paho's public ways out wait for a broker that may be hung
        for future in (self._connected, self._disconnected):
            if future.done() and not future.cancelled():
                future.exception()


async def run_until_first_ends(*works: Coroutine[Any, Any, None]) -> None:
    """Send and hear at once; the first work that ends ends all, and raises why the connection is lost."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
