"""Whom to tell, and by which way: addresses of apprise, a line each, in a file that is closed to other users."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from threading import Thread
from types import ModuleType
from typing import Protocol

from daemon.base.errors import UserError
from daemon.base.files import read_secret
from daemon.notify.notices import Notice

log = logging.getLogger("heliocube.notify")

_LONGEST_FILE = 65536
# Each step of a way has a limit of its own in apprise, and some have many steps.
_TAKEN_WITHIN_S = 120.0
_EXAMPLE = "such as ntfy://ntfy.lab/roof"


class Recipient(Protocol):
    """Somebody who can be sent notices."""

    name: str

    async def send(self, notice: Notice) -> bool:
        """Send a notice, and return whether the way took it."""


class AppriseRecipient:
    """One address of apprise.

    Parameters
    ----------
    address
        In the form that apprise's documentation gives.

    Attributes
    ----------
    name
        The address without its secrets, for the log.
    """

    def __init__(self, address: str) -> None:
        apprise = _import_apprise()
        # No redirects: if a server has moved, a page would be requested in place of sending the message, and its answer
        # would be taken for an acceptance.
        asset = apprise.AppriseAsset(http_redirects=False)
        service = apprise.Apprise.instantiate(address, asset=asset)
        if service is None:
            raise ValueError("apprise knows no such address")
        self._kinds = apprise.NotifyType
        self._service = service
        self._sending: Future[bool] | None = None
        self.name = str(service.url(privacy=True)).partition("?")[0]

    async def send(self, notice: Notice) -> bool:
        """Send a notice; return False if the way fails for any reason, or is silent for 120 s.

        A way that hangs gets no other notice before it has returned.
        """
        if self._sending is not None and not self._sending.done():
            return False
        kind = self._kinds.FAILURE if notice.urgent else self._kinds.WARNING
        if notice.is_recovery:
            kind = self._kinds.SUCCESS
        send = partial(self._service.notify, title=notice.title, body=notice.body, notify_type=kind)
        try:
            self._sending = _in_thread(send)
            async with asyncio.timeout(_TAKEN_WITHIN_S):
                return await asyncio.wrap_future(self._sending)
        except TimeoutError:
            log.warning("sending to %s has not ended within %g s", self.name, _TAKEN_WITHIN_S)
            return False
        except Exception:
            # apprise has some hundred ways by many authors: one may fail as its author did not expect, and the others
            # must go on.
            log.exception("the way to %s has failed", self.name)
            return False


def recipients_of(path: Path | None) -> list[AppriseRecipient]:
    """Return the recipients in a file; raises `UserError` with the number of a wrong line, never with its secrets."""
    if path is None:
        raise UserError(f"notify.people_file is not set: name a file with one apprise address on each line, {_EXAMPLE}")
    called = f"notify.people_file {path}"
    missing = f"{called} does not exist: write one apprise address on each line, {_EXAMPLE}, and run chmod 600 {path}"
    content = read_secret(path, _LONGEST_FILE, called, missing, UserError, group_may_read=True)
    found = []
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        try:
            found.append(AppriseRecipient(text))
        except (ValueError, TypeError):
            raise UserError(f"{called}, line {number}: no address that apprise knows; write one {_EXAMPLE}") from None
    if not found:
        raise UserError(f"{called} names nobody: write one apprise address on each line, {_EXAMPLE}")
    return found


def _in_thread(call: Callable[[], object]) -> "Future[bool]":
    """Call in a thread that neither another one nor the end of the process has to wait for."""
    future: Future[bool] = Future()
    future.set_running_or_notify_cancel()

    def run() -> None:
        try:
            future.set_result(bool(call()))
        except BaseException as error:  # noqa: BLE001 - handed to whoever waits, as it is
            future.set_exception(error)

    Thread(target=run, name="notify", daemon=True).start()
    return future


def _import_apprise() -> ModuleType:
    try:
        import apprise  # noqa: PLC0415 - an extra, which the service does without
    except ImportError:
        raise UserError(
            "apprise is not installed: pip install --require-hashes -r deploy/lock/notify.txt, or heliocube[notify]"
        ) from None
    return apprise
