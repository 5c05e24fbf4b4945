"""The address of the heartbeat may be out of reach in many ways; each is reported as what it is."""

import asyncio
import contextlib
import socket
import ssl
from threading import Thread

import pytest

from daemon.notify.courier import send_heartbeat
from tests.support.addresses import free_port
from tests.support.broker import CERTIFICATES


def told_of_server(certificate):
    """Return what is reported about a server with this certificate, or without TLS, asked by https."""
    context = None
    if certificate is not None:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(CERTIFICATES / certificate, CERTIFICATES / "broker.key")

    def answer():
        with contextlib.suppress(OSError), listening.accept()[0] as peer:
            if context is None:
                peer.sendall(b"no such thing")
            else:
                context.wrap_socket(peer, server_side=True).close()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = Thread(target=answer)
        server.start()
        told = asyncio.run(send_heartbeat(f"https://127.0.0.1:{listening.getsockname()[1]}/ping"))
        server.join()
    return told


@pytest.mark.parametrize(
    ("trusted", "certificate", "trouble"),
    [
        ("ca.pem", "broker.pem", "the connection broke off"),
        ("expired.pem", "expired.pem", "its certificate is out of date by this machine's clock"),
        ("other-ca.pem", "broker.pem", "its certificate is not accepted: unable to get local issuer certificate"),
        ("ca.pem", None, "it does not speak TLS there: is https right?"),
    ],
)
def test_each_failure_of_the_heartbeat_over_https_is_reported_with_its_own_cause(
    monkeypatch, trusted, certificate, trouble
):
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATES / trusted))
    assert told_of_server(certificate) == trouble


def test_the_heartbeat_reports_an_unknown_host_name_and_a_port_where_nothing_listens_differently():
    assert asyncio.run(send_heartbeat("http://nowhere.invalid/ping")) == "its name cannot be resolved"
    assert asyncio.run(send_heartbeat(f"http://127.0.0.1:{free_port()}/ping")) == "nothing listens there"
    # Where localhost has two addresses, both are tried.
    assert asyncio.run(send_heartbeat(f"http://localhost:{free_port()}/ping")) == "nothing listens there"
