"""Messages to the service manager (sd_notify(3)), without a library."""

import socket
from collections.abc import Mapping


class Notifier:
    """Tells systemd how the service is; says nothing where there is no systemd.

    A message that cannot be delivered at once is dropped: the service never waits for its manager, nor fails by it.

    Parameters
    ----------
    environment
        The process' environment: ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID`` are looked at.
    pid
        Of this process; a watchdog that is meant for another one is not ours to answer.
    """

    def __init__(self, environment: Mapping[str, str], pid: int) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of Linux's abstract socket names.
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._interval_s = _interval_s(environment, pid)

    @property
    def watchdog_interval_s(self) -> float | None:
        """How often to call `watchdog` [s], half of what the manager allows; None when it does not watch us."""
        return self._interval_s

    def ready(self) -> None:
        """Tell that start-up is finished."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows."""
        self._send("STATUS=" + " ".join(text.split()))

    def watchdog(self) -> None:
        """Tell that the service is alive."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Tell that shut-down has begun."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        family = getattr(socket, "AF_UNIX", None)
        if not self._address or family is None:
            return
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto(message.encode(), self._address)
        except OSError:
            return


def _interval_s(environment: Mapping[str, str], pid: int) -> float | None:
    microseconds = environment.get("WATCHDOG_USEC", "")
    if not (microseconds.isdecimal() and int(microseconds) > 0):
        return None
    if environment.get("WATCHDOG_PID", str(pid)) != str(pid):
        return None
    return int(microseconds) / 2e6
