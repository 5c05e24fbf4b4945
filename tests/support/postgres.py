"""A PostgreSQL in a process of its own, which a test may kill, hang and start again; skipped where there is none."""

import contextlib
import os
import pwd
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from tests.support import PATIENCE_S
from tests.support.addresses import free_port

_FOUND = [Path(found) for found in [shutil.which("initdb")] if found]
_FOUND += sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), reverse=True)
BINARIES = _FOUND[0].resolve().parent if _FOUND else None
WITHOUT_POSTGRES = "PostgreSQL is not here (Debian: postgresql): the tests of the archive are left out"
OWNER = "archive"
# PostgreSQL refuses to run as root.
_USER = "nobody" if os.geteuid() == 0 else None


class Postgres:
    """One server on a loopback port of its own, whose folder is deleted with it; `more` are settings."""

    def __init__(self, durable=False, **more):
        self.folder = Path(tempfile.mkdtemp(prefix="heliocube-pg-"))
        if _USER is not None:
            entry = pwd.getpwnam(_USER)
            os.chown(self.folder, entry.pw_uid, entry.pw_gid)
        self.port = free_port()
        self._data = self.folder / "data"
        self._run("initdb", "-D", self._data, "-U", OWNER, "-A", "trust", "-N", "-E", "UTF8", "--locale", "C")
        # A shell restarts the server after each death: it was started once for all tests, so no test has a new child.
        options = {"listen_addresses": "127.0.0.1", "port": self.port, "unix_socket_directories": self.folder}
        options |= {"max_connections": 20}
        if not durable:
            # A test's database survives the server's death; it need not survive the machine's.
            options |= {"fsync": "off", "shared_buffers": "16MB", "autovacuum": "off"}
        options |= more
        words = [str(BINARIES / "postgres"), "-D", str(self._data)]
        words += [word for key, value in options.items() for word in ("-c", f"{key}={value}")]
        loop = f"while [ ! -e end ]; do [ -e down ] || {shlex.join(words)}; sleep 0.1; done"
        with (self.folder / "log").open("a") as log:
            self._keeper = subprocess.Popen(["sh", "-c", loop], user=_USER, cwd=self.folder, stdout=log, stderr=log)
        self.start()

    def _run(self, program, *arguments):
        done = subprocess.run(
            [BINARIES / program, *arguments], user=_USER, cwd=self.folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

    def start(self):
        """Start, and return when it answers."""
        (self.folder / "down").unlink(missing_ok=True)
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            with contextlib.suppress(Exception):
                self.sql("SELECT 1")
                return
            time.sleep(0.05)
        raise AssertionError((self.folder / "log").read_text())

    def url(self, database="postgres", user=OWNER):
        return f"postgresql://{user}@127.0.0.1:{self.port}/{database}"

    def sql(self, statement, database="postgres", user=OWNER):
        """Run a statement as psql would; return the rows."""
        import psycopg  # noqa: PLC0415 - in an extra

        with psycopg.connect(self.url(database, user), autocommit=True, connect_timeout=5) as connection:
            cursor = connection.execute(statement)
            return cursor.fetchall() if cursor.description else []

    def dump(self, database):
        """Dump a database; return the file."""
        file = self.folder / f"{database}.dump"
        self._run("pg_dump", "-Fc", "-f", file, "-d", self.url(database))
        return file

    def restore(self, database, file):
        """Replace a database by a dump."""
        self.sql(f"DROP DATABASE {database} WITH (FORCE)")
        self.sql(f"CREATE DATABASE {database}")
        self._run("pg_restore", "-d", self.url(database), file)

    def _signal(self, number):
        """Send a signal to the server and to its children, each of which is a process group of its own."""
        pid = int((self._data / "postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for each in (pid, *map(int, children)):
            with contextlib.suppress(ProcessLookupError):
                os.kill(each, number)

    def kill(self):
        """Kill the server at once; it stays away until `start`."""
        (self.folder / "down").touch()
        self._signal(signal.SIGKILL)

    def hang(self):
        self._signal(signal.SIGSTOP)

    def resume(self):
        self._signal(signal.SIGCONT)

    def close(self):
        (self.folder / "end").touch()
        with contextlib.suppress(OSError):
            self._signal(signal.SIGKILL)
        self._keeper.wait()
        shutil.rmtree(self.folder, ignore_errors=True)
