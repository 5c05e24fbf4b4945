"""User, password and certificates, read anew at each connection, so that a corrected file needs no restart."""

import ssl
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.base.errors import UserError
from daemon.base.files import read_secret

if TYPE_CHECKING:
    from daemon.config.links import MqttSettings

_LONGEST = 4096


class CredentialsError(UserError):
    """A file of [mqtt] cannot be used; the message names the key, the file and the remedy."""


def load_user(path: Path) -> tuple[str, str]:
    """Return user and password from a file of one line, ``user:password``.

    Raises
    ------
    CredentialsError
        The file is missing, has another form, or is open to others than its owner and its group's readers. Windows
        has no such file modes; there they are not looked at.
    """
    called = f"mqtt.credentials_file: {path}"
    missing = f"mqtt.credentials_file: there is no file {path}: write user:password into it, mode 0600"
    content = read_secret(path, _LONGEST + 1, called, missing, CredentialsError, group_may_read=True)
    try:
        user, colon, password = content.decode().rstrip("\r\n").partition(":")
    except UnicodeDecodeError:
        user = colon = password = ""
    if not (user and colon and password) or len(content) > _LONGEST or "\n" in password:
        raise CredentialsError(f"{called} is not one line with user:password")
    return user, password


def tls_context(settings: "MqttSettings") -> ssl.SSLContext:
    """Return the context that checks the broker's certificate and has this client's own; raises `CredentialsError`."""
    try:
        context = ssl.create_default_context(cafile=settings.ca_file)
    except FileNotFoundError:
        raise CredentialsError(f"mqtt.ca_file: there is no file {settings.ca_file}") from None
    except OSError as error:
        raise CredentialsError(
            f"mqtt.ca_file: {settings.ca_file} has no certificates in PEM form ({_reason(error)})"
        ) from None
    if settings.certificate_file is not None:
        try:
            context.load_cert_chain(settings.certificate_file, settings.certificate_key_file)
        except OSError as error:
            raise CredentialsError(
                f"mqtt.certificate_file: {settings.certificate_file} and mqtt.certificate_key_file are no pair of"
                f" certificate and key in PEM form ({_reason(error)})"
            ) from None
    return context


def _reason(error: OSError) -> str:
    return getattr(error, "reason", None) or error.strerror or type(error).__name__
