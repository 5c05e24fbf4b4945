"""The lasting link to the broker: connects, announces itself, sends, listens, and comes back after every loss."""

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable
from random import Random

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.reconnect import Backoff, Outage
from daemon.base.records import Event, Record
from daemon.base.words import pluralise
from daemon.config.links import MqttSettings
from daemon.mqtt.connection import Connection, ConnectionLostError, Incoming, VersionRefusedError, run_until_first_ends
from daemon.mqtt.outbox import Lane, Message, Outbox
from daemon.mqtt.topics import Topics
from daemon.service.status import LinkStatus

log = logging.getLogger("heliocube.mqtt")

ONLINE, OFFLINE = b"online", b"offline"

_FIRST_DELAY_S = 1.0
_LONGEST_DELAY_S = 60.0
# A connection has proven itself after this long: only then is the next delay a short one again.
_PROVEN_S = 30.0
# A link that comes and goes is reported as one outage: if it is lost again within this time, it counts as back only
# after as long a time.
_STEADY_S = 600.0
_ECHO_WITHIN_S = 10.0
_REPORT_AGAIN_S = 3600.0
_LEAVE_WITHIN_S = 1.5
# If the connection ends twice at a message of this length or less, the cause is not the length.
_NEVER_TOO_LONG_BYTES = 4096

Handler = Callable[[Incoming], None]


class Link:
    """Keeps one connection, and publishes on the availability topic whether there is one.

    Parameters
    ----------
    settings, topics
        The broker, and under which names this process is known there.
    clock, random
        The service's time; jitter of reconnection.
    publish
        Called with an event when the link is lost or back.
    speed
        The clock runs this many times as fast as the machine's.
    """

    def __init__(
        self,
        settings: MqttSettings,
        topics: Topics,
        clock: Clock,
        random: Random,
        publish: Callable[[Record], None],
        speed: float,
    ) -> None:
        self._settings = settings
        self._topics = topics
        self._clock = clock
        self._publish = publish
        self._speed = speed
        # So lab/roof-a and lab/roof/a get different names.
        self._client_id = settings.client_id or topics.base.replace("-", "--").replace("/", "-")
        self._backoff = Backoff(random, _FIRST_DELAY_S, 2.0, _LONGEST_DELAY_S)
        self._outbox = Outbox(settings.queue_messages)
        self._outage = Outage(log, "the MQTT broker")
        self._handlers: dict[str, list[Handler]] = {topics.status: [self._receive_status]}
        self._as_published: set[str] = set()
        self._is_mqtt5 = True
        self._births: list[Callable[[], list[Message]]] = []
        self._troubles: dict[str, str] = {}
        self._reported_s: dict[str, float] = {}
        self._connected = False
        self._down_why: str | None = "not connected yet"
        self._reported_back_s = -math.inf
        self._unsteady = False
        self._renounced = False
        self._most_bytes = self._observed_most_bytes = math.inf
        self._last_failed_payload = b""
        self._reported_dropped = 0
        self._since_utc_s = clock.utc()
        self._dropped_since_utc_s: float | None = None
        self._connections = self._sent = self._received = 0

    @property
    def connected(self) -> bool:
        """Whether there is a connection now."""
        return self._connected

    @property
    def most_bytes(self) -> float:
        """How long a payload may be, as far as the broker of the last connection has said, or shown."""
        return min(self._most_bytes, self._observed_most_bytes)

    @property
    def status(self) -> LinkStatus:
        """A snapshot for displays."""
        return LinkStatus(
            broker=f"{self._settings.host}:{self._settings.port}",
            connected=self._connected,
            since_utc_s=self._since_utc_s,
            down_why=None if self._connected else self._down_why,
            connections=self._connections,
            waiting=self._outbox.waiting,
            sent=self._sent,
            received=self._received,
            dropped=self._outbox.dropped,
            dropped_since_utc_s=self._dropped_since_utc_s,
            troubles=tuple(self._troubles.values()),
        )

    def listen(self, topic: str, handler: Handler, *, as_published: bool = False) -> None:
        """Give each message on `topic` to `handler`, besides other handlers; it must not block.

        With `as_published` a message also counts as retained if it was published as retained just now. Only a broker of
        MQTT 5 tells that, not one of 3.1.1.
        """
        self._handlers.setdefault(topic, []).append(handler)
        if as_published:
            self._as_published.add(topic)

    def at_birth(self, messages: Callable[[], list[Message]]) -> None:
        """Send what `messages` returns each time that a connection is made, before anything that waits."""
        self._births.append(messages)

    def send(self, message: Message, *, answer: bool = False) -> None:
        """Queue a message; without a connection it waits. An `answer` to somebody's request has a queue of its own."""
        self._outbox.put(message, Lane.ANSWERS if answer else Lane.TELEMETRY)
        self._date_the_first_loss()

    def is_waiting(self, message: Message) -> bool:
        """Return whether this very message waits to be sent."""
        return message in self._outbox

    def send_now(self, message: Message) -> None:
        """Send a message before all that wait; without a connection it is not sent at all."""
        if self._connected:
            self._outbox.put(message, Lane.URGENT)

    def set_trouble(self, subject: str, sentence: str | None) -> None:
        """Show what does not work, or with None that it works again; the log has each subject once an hour at most."""
        now_s = self._clock.monotonic()
        if sentence is None:
            if self._troubles.pop(subject, None) is not None:
                log.debug("%s works again", subject)
        else:
            if now_s - self._reported_s.get(subject, -math.inf) >= _REPORT_AGAIN_S and subject not in self._troubles:
                self._reported_s[subject] = now_s
                log.warning("%s", sentence)
                self._report(sentence)
            self._troubles[subject] = sentence

    def disable(self, sentence: str) -> None:
        """Never connect, and show why; to be called before `run`."""
        self._renounced = True
        self._down_why = sentence
        log.warning("%s", sentence)
        self._report(sentence)

    async def run(self) -> None:
        """Keep the link until cancelled; then say on the availability topic that it ends."""
        if self._renounced:
            await asyncio.Event().wait()
        while True:
            try:
                await self._connect_and_serve()
            except VersionRefusedError:
                self._is_mqtt5 = False
                log.info(
                    "the MQTT broker speaks 3.1.1 and not 5, so it does not show which messages were published retained"
                )
                continue
            except (ConnectionLostError, UserError) as error:
                self._note_loss(str(error))
            except Exception as error:  # noqa: BLE001 - nothing about a broker may end the service; it is logged
                self._note_loss(f"{self.status.broker} cannot be used: {ascii(error)[:200]}")
            await asyncio.sleep(self._backoff.next_s() * self._speed)

    async def _connect_and_serve(self) -> None:
        will = Message(self._topics.status, OFFLINE, 1, retain=True)
        connection = Connection(self._settings, self._client_id, will, self._speed, modern=self._is_mqtt5)
        await connection.open()
        self._most_bytes = connection.most_bytes
        timers: list[asyncio.TimerHandle] = []
        try:
            try:
                await self._subscribe_and_announce(connection)
            except ConnectionLostError as error:
                rights = f"does it let this user read and write {self._topics.base}/#?"
                raise ConnectionLostError(f"{error} as soon as it was used: {rights}") from None
            timers = self._start_timers()
            await run_until_first_ends(self._send_all(connection), self._receive_all(connection))
        except asyncio.CancelledError:
            with contextlib.suppress(ConnectionLostError, TimeoutError):
                async with asyncio.timeout(_LEAVE_WITHIN_S * self._speed):
                    await connection.publish(will)
            raise
        except (ConnectionLostError, UserError) as error:
            # To leave a broker that hangs takes a while, and meanwhile the status has to say that the link is down.
            self._down_why = str(error)
            raise
        finally:
            for timer in timers:
                timer.cancel()
            if self._connected:
                self._connected, self._since_utc_s = False, self._clock.utc()
            self._outbox.forget_urgent()
            await connection.close()

    async def _subscribe_and_announce(self, connection: Connection) -> None:
        for topic in self._handlers:
            granted = await connection.subscribe(topic, as_published=topic in self._as_published)
            self.set_trouble(topic, None if granted else f"the broker does not let {self._client_id} listen to {topic}")
        await connection.publish(Message(self._topics.status, ONLINE, 1, retain=True))
        for messages in self._births:
            for message in messages():
                await self._publish_on(connection, message)
        self._connected, self._since_utc_s = True, self._clock.utc()
        self._connections += 1
        self._down_why = None

    def _start_timers(self) -> list[asyncio.TimerHandle]:
        loop = asyncio.get_running_loop()
        self._echo_timer = loop.call_later(_ECHO_WITHIN_S * self._speed, self._report_missing_echo)
        back_after_s = _STEADY_S if self._unsteady else 0.0
        return [
            self._echo_timer,
            loop.call_later(_PROVEN_S * self._speed, self._backoff.reset),
            loop.call_later(back_after_s * self._speed, self._count_as_back),
        ]

    async def _send_all(self, connection: Connection) -> None:
        while True:
            message = await self._outbox.take()
            try:
                self._sent += await self._publish_on(connection, message)
            except ConnectionLostError:
                if message.qos:
                    self._outbox.put_back(message)
                    self._date_the_first_loss()
                    self._suspect_message_length(message)
                raise
            if not self._outage.is_down:
                self._note_working()

    def _suspect_message_length(self, message: Message) -> None:
        """If the connection ends twice at the same message, take its length to be above a limit that was not told."""
        if message.payload == self._last_failed_payload and len(message.payload) > _NEVER_TOO_LONG_BYTES:
            self._observed_most_bytes = min(self._observed_most_bytes, len(message.payload) - 1)
        self._last_failed_payload = message.payload

    async def _publish_on(self, connection: Connection, message: Message) -> bool:
        """Publish a message unless the broker would end the connection at its length; return whether it is sent."""
        length, wrong = len(message.payload), None
        if length > self._most_bytes:
            most = f"the broker takes no message of more than {self._most_bytes:.0f} bytes"
            wrong = f"{most}, and one for {message.topic} has {length}: raise its limit (mosquitto: max_packet_size)"
        self.set_trouble(f"the length on {message.topic}", wrong)
        if wrong is None:
            await connection.publish(message)
        return wrong is None

    async def _receive_all(self, connection: Connection) -> None:
        async for message in connection.incoming():
            self._received += 1
            self._call_handlers(message)

    def _call_handlers(self, message: Incoming) -> None:
        subject, wrong = f"a message on {message.topic}", None
        for handler in self._handlers.get(message.topic, ()):
            try:
                handler(message)
            except Exception as error:  # noqa: BLE001 - no message may end the service; this is logged and shown
                wrong = f"{subject} cannot be used: {ascii(error)[:200]}"
        self.set_trouble(subject, wrong)

    def _receive_status(self, message: Incoming) -> None:
        if message.retained:
            return
        if message.payload == ONLINE:
            self._echo_timer.cancel()
            self.set_trouble(self._topics.status, None)
        else:
            # The will of an earlier connection, or somebody else's message: it is not true.
            self._outbox.put(Message(self._topics.status, ONLINE, 1, retain=True), Lane.URGENT)

    def _report_missing_echo(self) -> None:
        self.set_trouble(
            self._topics.status,
            f"what is published on {self._topics.status} does not come back: the broker must let this user read and"
            f" write {self._topics.base}/#",
        )

    def _count_as_back(self) -> None:
        now_s = self._clock.monotonic()
        self._unsteady = False
        if self._reported_back_s == -math.inf and not self._outage.is_down:
            log.info("connected to the MQTT broker at %s:%d", self._settings.host, self._settings.port)
        if self._outage.is_down:
            self._reported_back_s = now_s
        self._note_working()

    def _note_working(self) -> None:
        text = self._outage.up(self._clock.monotonic())
        if text:
            lost = self._outbox.dropped - self._reported_dropped
            self._reported_dropped = self._outbox.dropped
            dropped = f"; {pluralise(lost, 'message was', 'messages were')} dropped during the outage, the oldest first"
            self._report(f"{text}{dropped if lost else ''}")

    def _note_loss(self, why: str) -> None:
        self._down_why = why
        now_s = self._clock.monotonic()
        self._unsteady = self._unsteady or now_s - self._reported_back_s < _STEADY_S * self._speed
        text = self._outage.down(now_s, why)
        if text:
            self._report(text)

    def _date_the_first_loss(self) -> None:
        if self._outbox.dropped and self._dropped_since_utc_s is None:
            self._dropped_since_utc_s = self._clock.utc()

    def _report(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "mqtt", text))
