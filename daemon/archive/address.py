"""Where an archive is: the URL of a PostgreSQL database, with the name of an installation behind it."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from daemon.base.errors import ExitCode, UserError
from daemon.base.files import read_secret
from daemon.config.database import check_database_hosts

if TYPE_CHECKING:
    import psycopg

SCHEMES = ("postgresql://", "postgres://")
_CONNECT_S = 10
_LONGEST_PASSWORD = 1024
_WHERE_IT_IS = "archive.password_file, or the file of PGPASSFILE, mode 0600"
_URL_FORM = "postgresql://USER@HOST/DATABASE"
# The server's own words, in whatever language: libpq writes two spaces after their severity, and a connection that
# fails carries no SQLSTATE.
_SERVER_MESSAGE = re.compile(r'(?:.* failed: )?[^:"]+:  (.+)')
# SQLSTATEs by which the database refuses records, besides those of data (22) and of constraints (23): what a trigger
# raises, in any language, a check of a view, a limit such as that of an index, and a column of another type.
_RECORD_SQLSTATES = ("P0", "2F", "38", "39", "44", "54", "42804")


# No warnings of psycopg's about a failed rollback, as after Ctrl-C: the first error is told, and the connection closed.
logging.getLogger("psycopg").setLevel(logging.ERROR)


class ArchiveError(UserError):
    """The archive cannot be used as it was asked to be; the message is one sentence."""


class ArchiveUnreachableError(ArchiveError):
    """The database does not answer, now; it may later."""

    exit_code = ExitCode.UNREACHABLE


class PagesRefusedError(ArchiveError):
    """The database does not take the records of the pages, or of one of them."""


class RecordsRefusedError(PagesRefusedError):
    """The database does not take single records of the pages; it would take the others."""


@dataclass(frozen=True, slots=True)
class ArchiveAddress:
    """A database, and one installation in it.

    Attributes
    ----------
    url
        As libpq takes it, without a password.
    installation
        What stands behind ``#``; empty for the only one.
    password
        Of its user; if it is empty, libpq looks into the file of PGPASSFILE.
    """

    url: str
    installation: str = ""
    password: str = field(default="", repr=False)

    def __str__(self) -> str:
        return self.url + (f"#{self.installation}" if self.installation else "")


def is_archive(text: str) -> bool:
    """Whether a text is meant as the URL of an archive, and not as a folder."""
    return text.startswith(SCHEMES)


def parse_archive(text: str) -> ArchiveAddress:
    """Return the database and the installation of ``postgresql://USER@HOST/DATABASE#PREFIX/NAME``.

    Raises
    ------
    ArchiveError
        It is no such URL, or it holds a password, which every user of the machine could read in the list of processes.
    """
    url, _, installation = text.partition("#")
    try:
        parts = urlsplit(url)
        password, database = parts.password, parts.path.strip("/")
        _ = parts.port
        check_database_hosts(url)
    except ValueError as error:
        # The message leaves out the text, which may hold a password.
        raise ArchiveError(f"this is not an address of an archive ({error}); an archive is {_URL_FORM}") from None
    if not is_archive(url) or not database or "/" in database:
        raise ArchiveError(f"{text} is not an address of an archive: write {_URL_FORM}")
    if password is not None or "password=" in parts.query:
        shown = text.replace(f":{password}@", ":...@") if password else "the address"
        raise ArchiveError(
            f"{shown} holds a password: leave it out, and write it into archive.password_file or the file of PGPASSFILE"
        )
    return ArchiveAddress(url, unquote(installation))


def load_password(path: Path) -> str:
    """Return the password that a file of one line holds.

    Raises
    ------
    ArchiveError
        The file is missing, has another form, or is open to others than its owner and its group's readers.
    """
    called = f"archive.password_file: {path}"
    missing = f"archive.password_file: there is no file {path}: write the database's password into it, mode 0600"
    content = read_secret(path, _LONGEST_PASSWORD + 1, called, missing, ArchiveError, group_may_read=True)
    try:
        password = content.decode().rstrip("\r\n")
    except UnicodeDecodeError:
        password = ""
    if not password or "\n" in password or len(content) > _LONGEST_PASSWORD:
        raise ArchiveError(f"{called} is not one line with a password")
    return password


def connect_to_archive(address: ArchiveAddress, application: str) -> "psycopg.Connection":
    """Return a connection.

    Raises
    ------
    ArchiveError
        The database is not there, does not let this user in, or cannot hold every text; psycopg is not installed.
    ArchiveUnreachableError
        Nothing answers there.
    """
    try:
        import psycopg  # noqa: PLC0415 - it is in an extra
    except ImportError:
        raise ArchiveError(
            "an archive needs psycopg: run deploy/install.sh --role archive, or pip install 'heliocube[archive]'"
        ) from None
    try:
        connection = psycopg.connect(
            address.url,
            connect_timeout=_CONNECT_S,
            application_name=application,
            password=address.password or None,
            # Set here, whatever a role or the environment says.
            client_encoding="utf8",
        )
    except psycopg.OperationalError as error:
        raise _reason(address, error) from None
    except (psycopg.Error, UnicodeError) as error:
        # A UnicodeError comes from a host in the environment whose name is not valid.
        raise ArchiveError(f"{address.url} is not an address of a database: {one_line(error)}") from None
    encoding = connection.info.parameter_status("server_encoding")
    if encoding not in (None, "UTF8"):
        connection.close()
        # Names and reasons are in any language, and a database of SQL_ASCII returns no text as text.
        raise ArchiveError(
            f"the database {address.url} has the encoding {encoding}: make one with"
            " 'createdb --encoding UTF8 --template template0'"
        )
    return connection


@contextmanager
def translate_database_errors(address: ArchiveAddress) -> Iterator[None]:
    """Turn what the database raises into a sentence."""
    import psycopg  # noqa: PLC0415 - it is in an extra

    try:
        yield
    except psycopg.errors.ReadOnlySqlTransaction as error:
        raise ArchiveError(
            f"the database {address.url} takes no records ({one_line(error)}): if it is a replica, name the database"
            " that it follows; else set default_transaction_read_only off for it"
        ) from None
    except psycopg.errors.InsufficientPrivilege as error:
        raise ArchiveError(
            f"the database {address.url} does not let this user do that ({one_line(error)}): let its owner grant it"
        ) from None
    except psycopg.errors.OutOfMemory as error:
        # Out of locks: a transaction needs one for each day. Pages with fewer days need no more locks than there are.
        raise PagesRefusedError(f"the database cannot take the records in one transaction: {one_line(error)}") from None
    except (psycopg.OperationalError, psycopg.InterfaceError) as error:
        if _is_about_records(error):
            raise _records_refused(error) from None
        does = "does not answer" if error.sqlstate is None else "refuses"
        raise ArchiveUnreachableError(f"the database {address.url} {does}: {one_line(error)}") from None
    except (psycopg.DataError, psycopg.IntegrityError, UnicodeError) as error:
        raise _records_refused(error) from None
    except psycopg.Error as error:
        if _is_about_records(error):
            raise _records_refused(error) from None
        raise ArchiveError(f"the database {address.url} refuses: {one_line(error)}") from None


def _is_about_records(error: "psycopg.Error") -> bool:
    return (error.sqlstate or "").startswith(_RECORD_SQLSTATES)


def _records_refused(error: Exception) -> RecordsRefusedError:
    return RecordsRefusedError(f"the database does not take these records: {one_line(error)}")


def _reason(address: ArchiveAddress, error: "psycopg.OperationalError") -> ArchiveError:
    """Return the error for a failed connection: one that a person must put right, or one that may pass."""
    text = one_line(error)
    remedies = {
        "password authentication failed": f"correct {_WHERE_IT_IS}",
        "no password supplied": f"write it into {_WHERE_IT_IS}",
        "no pg_hba.conf entry": "allow this connection in pg_hba.conf",
        "Peer authentication failed": "allow this connection in pg_hba.conf, or name another user",
        "does not exist": "make it with createdb or createuser, or correct the address",
        "permission denied for database": "grant CONNECT on it to this user",
        "invalid": "correct the address",
        "could not parse network address": "correct the address",
        "definition of service": "correct the address, or write the service's file",
    }
    for part, remedy in remedies.items():
        if part in text:
            return ArchiveError(f"the database {address.url} refuses: {text}: {remedy}")
    does = "refuses" if _SERVER_MESSAGE.match(str(error)) else "does not answer"
    return ArchiveUnreachableError(f"the database {address.url} {does}: {text}")


def one_line(error: Exception) -> str:
    """Return the first line of what a database says, without its own preface."""
    first = str(error).strip().split("\n")[0]
    said = _SERVER_MESSAGE.match(first)
    return (said[1] if said else first).strip() or type(error).__name__
