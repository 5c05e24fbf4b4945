"""The command line's way to the running service. It imports little: a stop must not wait for libraries to load."""

import errno
import getpass
import json
import os
import re
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from daemon.api.configuration import QUERY_KEY, paths_of
from daemon.api.token import check_token, load_token
from daemon.base.addresses import DEFAULT_LISTEN, DROP_UNSENT_ON_CLOSE, Address, parse_address
from daemon.base.errors import ExitCode, InterruptedEarlyError, UserError
from daemon.base.files import parse_toml, toml_text

TOKEN_VARIABLE = "HELIOCUBE_TOKEN"  # noqa: S105 - the name of a variable, not what is in it
CONFIG_VARIABLE = "HELIOCUBE_CONFIG"

_TIMEOUT_S = 15.0
_LONGEST_NAME = 200
# The service cuts a reason to this length. A longer one could make the body longer than the service accepts.
_LONGEST_REASON = 200
_LONGEST_REPLY = 16 << 20
_OK = b"200"
_UNHEALTHY = b"503"
_ANOTHER_SERVICE = b"421"
_UNAUTHORISED = b"401"
# No such thing, or no such value.
_MISTYPED = (b"400", b"404", b"405", b"413", b"422")
# A service whose port is flooded may close a connection in favour of another; these requests may be sent again.
_REPEATABLE = ("/api/state", "/healthz", "/api/stop", "/api/stow", "/api/maintenance")
_TRIES = 3
_AGAIN_AFTER_S = 0.1
_OTHER_ADDRESS = "127.20.22.1"
_LENGTH = re.compile(rb"(?i)\r\ncontent-length: *(\d+)")
_ERRNOS_BEFORE_SENDING = (errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EADDRNOTAVAIL)


class NoServiceError(UserError):
    """Nothing answers where the service should be."""

    exit_code = ExitCode.UNREACHABLE


class CommandRefusedError(UserError):
    """The service answers, but refuses the command."""

    exit_code = ExitCode.REFUSED


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of a command.

    Attributes
    ----------
    text
        What the tracker did, in a sentence.
    exit_code
        `GOOD` where the effect was seen, whole or under way, and `NOT_SEEN` where it was not.
    page
        The whole answer.
    """

    text: str
    exit_code: ExitCode
    page: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Client:
    """Speaks to one service.

    Attributes
    ----------
    address
        Where its local interface listens.
    token
        For commands; None where there is none at hand.
    configuration
        The paths of the configuration whose service is meant; the service of another one carries out only a stop, and
        says so. Empty if the address was named instead.
    """

    address: Address
    token: str | None
    configuration: tuple[str, ...] = ()

    def state(self) -> dict[str, Any]:
        """Return the service's state; raises `UserError`."""
        return self._request("GET", "/api/state", None)

    def health(self) -> dict[str, Any]:
        """Return whether the service's work goes on; raises `UserError`."""
        return self._request("GET", "/healthz", None, also=(_UNHEALTHY,))

    def _no_token_text(self, name: str) -> str:
        if self.configuration:
            return (
                f"'{name}' needs the service's token, and {self.configuration[0]} has no api.token_file: give the"
                f" token that the service showed at its start, in {TOKEN_VARIABLE} or with --token-file"
            )
        return (
            f"'{name}' needs the service's token: name its configuration with --config, or its token with"
            f" --token-file or in {TOKEN_VARIABLE}; a service without api.token_file shows a token at its start"
        )

    def command(self, name: str, **arguments: float | str) -> Reply:
        """Give a command in the name of the user who runs this, and return its outcome; raises `UserError`."""
        if self.token is None:
            raise UserError(self._no_token_text(name))
        body = {"by": whoami(), **arguments}
        if "why" in arguments:
            body["why"] = _readable(str(arguments["why"]))[:_LONGEST_REASON]
        try:
            found = self._request("POST", f"/api/{name}", body)
        except KeyboardInterrupt:
            raise InterruptedEarlyError(
                "interrupted: the command may have been taken; see 'heliocube status'"
            ) from None
        seen = found.get("state") != "not-seen"
        return Reply(str(found.get("text", "")), ExitCode.GOOD if seen else ExitCode.NOT_SEEN, found)

    def _request(
        self, method: str, path: str, body: Mapping[str, float | str] | None, also: tuple[bytes, ...] = ()
    ) -> dict[str, Any]:
        sent = b"" if body is None else json.dumps(body, ensure_ascii=False).encode("utf-8", "replace")
        try:
            status, content = self._exchange_with_retries(method, path, sent)
        except ConnectionRefusedError:
            raise NoServiceError(
                f"nothing listens at {self.address}: the service is not running, or its api.listen is another address"
            ) from None
        except OSError as error:
            taken = "; it may have taken the command all the same: see 'heliocube status'"
            after = taken if method == "POST" and error.errno not in _ERRNOS_BEFORE_SENDING else ""
            why = error.strerror or error
            raise NoServiceError(f"the service at {self.address} does not answer: {why}{after}") from None
        try:
            found = json.loads(content)
        except ValueError:
            found = None
        refusal = found.get("error") if isinstance(found, dict) else None
        if isinstance(found, dict) and (status == _OK or (status in also and refusal is None)):
            return found
        if refusal is None:
            raise NoServiceError(
                f"the program that answers at {self.address} is not heliocube: see api.listen of the configuration"
            )
        if status == _ANOTHER_SERVICE:
            raise NoServiceError(str(refusal))
        if status == _UNAUTHORISED:
            self._require_meant("nothing was stopped" if path == "/api/stop" else "nothing is done")
        raise (UserError if status in _MISTYPED else CommandRefusedError)(str(refusal))

    def _require_meant(self, undone: str) -> None:
        """Raise `NoServiceError` if the service is another file's: it has another token and refuses every order."""
        try:
            status, content = self._exchange("GET", "/healthz", b"")
            found = json.loads(content)
        except (OSError, ValueError):
            return
        if status == _ANOTHER_SERVICE and isinstance(found, dict):
            raise NoServiceError(f"{undone}: {found.get('error')}")

    def _exchange_with_retries(self, method: str, path: str, body: bytes) -> tuple[bytes, bytes]:
        """Send a request, and again if the connection is cut off without an answer and the request may be repeated."""
        for _ in range(_TRIES - 1 if path in _REPEATABLE else 0):
            try:
                return self._exchange(method, path, body)
            except (ConnectionResetError, BrokenPipeError):
                time.sleep(_AGAIN_AFTER_S)
        return self._exchange(method, path, body)

    def _exchange(self, method: str, path: str, body: bytes) -> tuple[bytes, bytes]:
        """Send one request and return the status and the body of the reply.

        By hand, because the standard library's client takes longer to load than a stop may take.
        """
        query = "&".join(f"{QUERY_KEY}={quote(each)}" for each in self.configuration)
        lines = [f"{method} {path}{query and '?'}{query} HTTP/1.1", f"Host: {self.address}", "Connection: close"]
        if self.token is not None:
            lines.append(f"Authorization: Bearer {self.token}")
        lines.append(f"Content-Length: {len(body)}")
        with self._connect() as connection:
            if path != "/api/stop":
                # An order that was given up must not be carried out minutes later.
                connection.setsockopt(*DROP_UNSENT_ON_CLOSE)
            connection.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + body)
            reply = bytearray()
            while len(reply) < _LONGEST_REPLY and (part := connection.recv(65536)):
                reply += part
        head, end, content = bytes(reply).partition(b"\r\n\r\n")
        said = _LENGTH.search(head)
        if not reply or (head.startswith(b"HTTP/") and not (end and (said is None or len(content) >= int(said[1])))):
            raise ConnectionResetError(errno.ECONNRESET, "the connection was cut off before the end of the answer")
        return b"".join(head.split(b" ")[1:2]), content

    def _connect(self) -> socket.socket:
        place = self.address.host, self.address.port
        try:
            return socket.create_connection(place, _TIMEOUT_S)
        except OSError as error:
            if isinstance(error, TimeoutError):
                raise OSError(errno.EHOSTUNREACH, "timed out") from None
            if error.errno != errno.EADDRNOTAVAIL or not self.address.host.startswith("127."):
                raise
        # A flood from this machine has used up the ports of the usual address; each loopback address has its own.
        return socket.create_connection(place, _TIMEOUT_S, (_OTHER_ADDRESS, 0))


def whoami() -> str:
    """Return who runs this and where, such as ``ana@lab``, as far as the machine knows."""
    try:
        user = getpass.getuser()
    except (ImportError, KeyError, OSError):
        user = "somebody"
    text = f"{user}@{socket.gethostname()}"
    return text if text.isprintable() and len(text) <= _LONGEST_NAME else "somebody"


def _readable(text: str) -> str:
    """Return an argument of the command line as it was typed, also where the locale knows ASCII only."""
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    except UnicodeEncodeError:
        return text


def find_service(
    config: Path | None, api: str | None, token_file: Path | None, environment: Mapping[str, str] = os.environ
) -> Client:
    """Return the way to a service.

    Only [api] of the configuration is read: a mistake elsewhere in the file must not keep anyone from stopping the
    tracker.

    Parameters
    ----------
    config, api, token_file
        What the command line names: a configuration file, an address with a port, a token's file.
    environment
        May hold the path of the configuration and the token, where the command line names none.

    Raises
    ------
    UserError
        A file cannot be read, or an address is not valid.
    """
    address, named, meant = _place(config, api, environment)
    if token_file is None and environment.get(TOKEN_VARIABLE):
        return Client(address, check_token(environment[TOKEN_VARIABLE].strip(), TOKEN_VARIABLE), meant)
    chosen = token_file or named
    return Client(address, None if chosen is None else load_token(chosen), meant)


def find_without_token(config: Path | None, api: str | None, environment: Mapping[str, str] = os.environ) -> Client:
    """Return the way to a service for looking only, without a token. Arguments and errors: see `find_service`."""
    address, _, meant = _place(config, api, environment)
    return Client(address, None, meant)


def _place(
    config: Path | None, api: str | None, environment: Mapping[str, str]
) -> tuple[Address, Path | None, tuple[str, ...]]:
    if config is None and environment.get(CONFIG_VARIABLE):
        config = Path(environment[CONFIG_VARIABLE])
    listen, token_file, meant = (DEFAULT_LISTEN, None, ()) if config is None else _read_api(config)
    try:
        return parse_address(api or listen).reachable_address, token_file, () if api else meant
    except ValueError as error:
        raise UserError(f"{'--api' if api else 'api.listen'}: {error}") from None


def _read_api(config: Path) -> tuple[str, Path | None, tuple[str, ...]]:
    """Return where the service of a configuration listens, its token's file, and the paths by which it is known."""
    try:
        tables = parse_toml(toml_text(config))
    except OSError as error:
        raise UserError(f"{config} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{config} is not TOML: {error}; see 'heliocube config check {config}'") from None
    found = tables.get("api", {})
    listen = found.get("listen", DEFAULT_LISTEN) if isinstance(found, dict) else None
    token_file = found.get("token_file", "") if isinstance(found, dict) else None
    if not isinstance(listen, str) or not isinstance(token_file, str):
        raise UserError(f"the [api] of {config} is wrong; see 'heliocube config check {config}'")
    # A file with nothing but [api] only names an address and a token; it has no service of its own.
    meant = paths_of(config) if set(tables) - {"api"} else ()
    try:
        return listen, (config.parent / Path(token_file).expanduser()) if token_file else None, meant
    except RuntimeError as error:
        raise UserError(f"api.token_file in {config}: {error}") from None
