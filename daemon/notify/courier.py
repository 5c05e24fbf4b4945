"""Asking services for their alarms and telling people, until the end."""

import asyncio
import contextlib
import json
import logging
import os
import socket
import ssl
from collections.abc import Callable, Collection, Coroutine, Iterator, Sequence
from datetime import time
from functools import partial
from typing import Any

import httpx

from daemon.base.addresses import Address, parse_address
from daemon.base.clock import Clock, local_time
from daemon.base.errors import UserError
from daemon.base.process import SystemdNotifier, on_signals
from daemon.base.reconnect import Outage
from daemon.base.state import StateFolder
from daemon.config.links import NotifySettings
from daemon.notify.backlog import Backlog, QuietHours
from daemon.notify.notices import Notice, ServiceWatch
from daemon.notify.notification_state import NotificationState, NotificationStateFile
from daemon.notify.recipients import Recipient

log = logging.getLogger("heliocube.notify")

_ANSWER_WITHIN_S = 10.0
# The longest state that is read; the command line has the same limit.
_LONGEST_ANSWER = 16 << 20
# OpenSSL's numbers (x509_vfy.h) for a certificate that is not valid yet, or no longer.
_OUT_OF_DATE = (9, 10)
_Way = Callable[[], Coroutine[Any, Any, None]]


async def send_test_notice(
    settings: NotifySettings, recipients: Sequence[Recipient], report: Callable[[str], None]
) -> bool:
    """Send everybody one notice, and the heartbeat; report each in a line, and return whether all was taken."""
    text = "This is a test by 'heliocube notify --test'; nothing is the matter."
    notice = Notice("heliocube: a test", text, "warning")
    taken = []
    for recipient in recipients:
        taken.append(await recipient.send(notice))
        report(f"{recipient.name}: {'taken' if taken[-1] else 'not taken; see the lines above'}")
    if settings.heartbeat is not None:
        trouble = await send_heartbeat(settings.heartbeat)
        taken.append(trouble is None)
        report(f"heartbeat: {trouble or 'taken'}")
    return all(taken)


async def serve(
    settings: NotifySettings,
    recipients: Sequence[Recipient],
    clock: Clock,
    manager: SystemdNotifier,
    folder: StateFolder,
) -> None:
    """Tell people of alarms until SIGINT, SIGTERM or SIGHUP; `folder` keeps which alarms were told.

    Raises `UserError` if a service's address is not valid.
    """
    try:
        services = [parse_address(text) for text in settings.services]
    except ValueError as error:
        raise UserError(f"--api: {error}") from None
    loop, end = asyncio.get_running_loop(), asyncio.Event()

    def end_from_outside() -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended already
            loop.call_soon_threadsafe(end.set)

    # The client ignores the environment (`trust_env`): its proxies are for the world outside, not for the services.
    async with httpx.AsyncClient(trust_env=False) as client:
        courier = Courier(
            settings, services, recipients, clock, client, manager.watchdog, NotificationStateFile(folder)
        )
        with on_signals(end_from_outside):
            task = asyncio.create_task(courier.run())
            manager.ready()
            await asyncio.wait((task, asyncio.create_task(end.wait())), return_when=asyncio.FIRST_COMPLETED)
            manager.stopping()
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


class Courier:
    """Tells people of alarms; each person has a queue, so that a way that fails does not keep the others waiting.

    Parameters
    ----------
    settings
        Of the section [notify].
    services
        Addresses of their local interfaces.
    people
        Whom to tell.
    clock
        For intervals, and for the local time of the quiet hours.
    client
        Asks the services.
    alive
        Called after each round.
    file
        Keeps over a restart which alarms were told; None keeps nothing.
    """

    def __init__(
        self,
        settings: NotifySettings,
        services: Sequence[Address],
        people: Sequence[Recipient],
        clock: Clock,
        client: httpx.AsyncClient,
        alive: Callable[[], None] = lambda: None,
        file: NotificationStateFile | None = None,
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._client = client
        self._on_round = alive
        self._file = file or NotificationStateFile(StateFolder(None))
        now_s, before = clock.monotonic(), self._file.load()
        self._told = before
        own = settings.silent_after_s, settings.at_least, settings.dashboard, now_s
        self._watches = {
            service: ServiceWatch(str(service), *own, before.get(str(service), NotificationState()))
            for service in services
        }
        quiet = QuietHours(settings.quiet_from, settings.quiet_until)
        self._backlogs = [(recipient, Backlog(quiet, settings.most_per_hour)) for recipient in people]
        self._outages = {recipient.name: Outage(log, f"the way to {recipient.name}") for recipient in people}
        self._heartbeat_outage = Outage(log, "the heartbeat")
        self._last_heartbeat_s = -settings.heartbeat_every_s
        self._ways: dict[_Way, Outage] = {self._send_heartbeat: self._heartbeat_outage} | {
            partial(self._send_due, *one): self._outages[one[0].name] for one in self._backlogs
        }
        self._running_tasks: dict[_Way, asyncio.Task[None]] = {}

    async def run(self) -> None:
        """Ask and tell until cancelled."""
        try:
            while True:
                await self.step()
                self._on_round()
                await asyncio.sleep(self._settings.poll_every_s)
        finally:
            for telling in self._running_tasks.values():
                telling.cancel()
            self._save_notification_state()
            self._file.close()

    async def step(self) -> Collection[asyncio.Task[None]]:
        """Ask every service once, and begin to send the notices; return the tasks that are under way.

        A way that is still busy with an earlier notice gets no other, and delays neither the other ways nor the next
        round.
        """
        self._save_notification_state()
        found = await asyncio.gather(*(self._ask(service, watch) for service, watch in self._watches.items()))
        for notice in (notice for notices in found for notice in notices):
            log.info("%s", notice.title)
            for _, backlog in self._backlogs:
                backlog.put(notice)
        self._told = {str(service): watch.notification_state for service, watch in self._watches.items()}
        for way, outage in self._ways.items():
            before = self._running_tasks.get(way)
            if before is not None and not before.done():
                continue
            if before is not None and (error := before.exception()) is not None:
                outage.down(self._clock.monotonic(), f"it cannot be used: {ascii(error)[:200]}")
            self._running_tasks[way] = asyncio.create_task(way())
        return self._running_tasks.values()

    def _save_notification_state(self) -> None:
        """Save which alarms were told, once everybody has been told: otherwise they are told again after a restart."""
        if all(backlog.is_empty for _, backlog in self._backlogs):
            self._file.save(self._told)

    async def _ask(self, service: Address, watch: ServiceWatch) -> list[Notice]:
        try:
            # The client's own limit holds for each piece of an answer, and an answer may have pieces without end.
            async with asyncio.timeout(_ANSWER_WITHIN_S):
                state = await self._fetch_state(service)
            return watch.note_answer(state, self._clock.monotonic())
        except (httpx.HTTPError, TimeoutError) as error:
            return watch.note_failure(_reason(error), self._clock.monotonic())
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return watch.note_failure("the program that answers there is not heliocube", self._clock.monotonic())

    async def _fetch_state(self, service: Address) -> Any:
        # Not compressed: a few compressed bytes may become gigabytes.
        plain, content = {"Accept-Encoding": "identity"}, bytearray()
        url = f"http://{service.reachable_address}/api/state"
        async with self._client.stream("GET", url, headers=plain, timeout=_ANSWER_WITHIN_S) as reply:
            reply.raise_for_status()
            async for part in reply.aiter_raw():
                content += part
                if len(content) > _LONGEST_ANSWER:
                    raise ValueError("too long for a state")
        return json.loads(content)

    async def _send_due(self, recipient: Recipient, backlog: Backlog) -> None:
        due = backlog.due(self._clock.monotonic(), self._local())
        if due is None:
            return
        notice, stands_for = due
        outage = self._outages[recipient.name]
        if await recipient.send(notice):
            backlog.remove_sent(stands_for)
            outage.up(self._clock.monotonic())
        else:
            pause_s = backlog.note_failure(self._clock.monotonic())
            outage.down(self._clock.monotonic(), f"a message was not accepted; next try in {pause_s:g} s")

    async def _send_heartbeat(self) -> None:
        settings, now_s = self._settings, self._clock.monotonic()
        if settings.heartbeat is None or now_s - self._last_heartbeat_s < settings.heartbeat_every_s:
            return
        self._last_heartbeat_s = now_s
        trouble = await send_heartbeat(settings.heartbeat)
        if trouble is None:
            self._heartbeat_outage.up(now_s)
        else:
            self._heartbeat_outage.down(now_s, trouble)

    def _local(self) -> time:
        return local_time(self._clock.utc()).time()


async def send_heartbeat(address: str) -> str | None:
    """Ask the address of the heartbeat once, and return what is wrong with it, or None."""
    try:
        async with (
            asyncio.timeout(_ANSWER_WITHIN_S),
            httpx.AsyncClient(timeout=_ANSWER_WITHIN_S, follow_redirects=True) as client,
            client.stream("GET", address) as reply,
        ):
            # The body of the answer is not read.
            reply.raise_for_status()
    except (httpx.HTTPError, httpx.InvalidURL, TimeoutError) as error:
        return _reason(error)
    except (OSError, ValueError, ImportError) as error:
        # The environment names a proxy or certificates that cannot be used.
        return f"it cannot be asked: {ascii(error)[:200]}"
    return None


def _reason(error: Exception) -> str:
    if isinstance(error, httpx.HTTPStatusError):
        return f"it answers with {error.response.status_code}"
    if isinstance(error, httpx.ConnectError):
        return next(filter(None, map(_not_connected, _causes(error))), "it cannot be reached")
    if isinstance(error, (httpx.TimeoutException, TimeoutError)):
        return "it does not answer in time"
    return "the connection broke off"


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and its causes; for a name with several addresses, the error of each."""
    while error is not None:
        yield error
        if isinstance(error, BaseExceptionGroup):
            yield from error.exceptions
        error = error.__cause__ or error.__context__


def _not_connected(error: BaseException) -> str:
    """Return why there is no connection, as far as an error tells; empty if it does not."""
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code in _OUT_OF_DATE:
            return "its certificate is out of date by this machine's clock"
        return f"its certificate is not accepted: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        return "it does not speak TLS there: is https right?"
    if isinstance(error, socket.gaierror):
        return "its name cannot be resolved"
    if isinstance(error, ConnectionRefusedError):
        return "nothing listens there"
    # An error without a number is a library's own, which says less than its cause.
    return f"it cannot be reached: {os.strerror(error.errno)}" if isinstance(error, OSError) and error.errno else ""
