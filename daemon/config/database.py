"""The hosts in the URL of a database."""

from urllib.parse import parse_qsl, urlsplit

from drivers.settings import check_host


def check_database_hosts(url: str) -> None:
    """Raise a `ValueError` for the URL of a database with a host that has no name, also one behind the ?."""
    parts = urlsplit(url)
    hosts = [parts.hostname or "", *(value for key, value in parse_qsl(parts.query) if key == "host")]
    for host in ",".join(hosts).split(","):
        # Such a one is the folder of a socket.
        if not host.startswith("/"):
            check_host(host)
