"""The bridge's key file, read again when it changes: a key is replaced while the service runs, and no scan is lost."""

import asyncio
import logging
from collections.abc import Callable
from pathlib import Path

from daemon.bridge.signing import KeyFileError, load_keys

_log = logging.getLogger("heliocube.bridge")

READ_EVERY_S = 5.0


class KeyFileWatch:
    """Passes on the keys of a file whenever they have changed.

    Parameters
    ----------
    path
        The file.
    keys
        The keys that were read at the start.
    take_keys
        Called with the new keys; the first one signs.
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(
        self, path: Path, keys: tuple[bytes, ...], take_keys: Callable[[tuple[bytes, ...]], None], speed: float
    ) -> None:
        self._path = path
        self._keys = keys
        self._take_keys = take_keys
        self._speed = speed
        self._trouble = ""

    async def run(self) -> None:
        """Read until cancelled; a file that cannot be used is reported once, and the earlier keys stay in force."""
        while True:
            await asyncio.sleep(READ_EVERY_S * self._speed)
            try:
                keys = await asyncio.to_thread(load_keys, self._path)
            except KeyFileError as error:
                self._report(str(error))
                continue
            self._trouble = ""
            if keys != self._keys:
                self._keys = keys
                self._take_keys(keys)
                also = ", and a second one is accepted" if len(keys) > 1 else ""
                _log.warning("the bridge's key file %s has changed: its first key signs scans%s", self._path, also)

    def _report(self, trouble: str) -> None:
        if trouble != self._trouble:
            _log.warning("%s; the keys that were read before stay in force", trouble)
        self._trouble = trouble
