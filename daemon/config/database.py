"""The hosts in the URL of a database."""

from urllib.parse import parse_qsl, urlsplit

from drivers.settings import check_host


def check_database_hosts(url: str) -> None:
    """Raise a `ValueError` if a host in the URL of a database is not valid, also one in its query."""
    parts = urlsplit(url)
    hosts = [parts.hostname or "", *(value for key, value in parse_qsl(parts.query) if key == "host")]
    for host in ",".join(hosts).split(","):
        # A host that begins with / is the folder of a socket.
        if not host.startswith("/"):
            check_host(host)
