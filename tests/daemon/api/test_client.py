"""The command line's way to the service where the network is bad."""

import socket
import subprocess
import sys

import pytest

from daemon.api import client
from daemon.api.client import Client, NoServiceError
from daemon.base.addresses import parse_address
from tests.support.bad_network import without_namespaces

# Two ports are all that one address has; two connections of somebody else take them.
ALL_TAKEN = """
import socket, subprocess, threading
from pathlib import Path
from daemon.api.client import Client
from daemon.base.addresses import parse_address

subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
Path("/proc/sys/net/ipv4/ip_local_port_range").write_text("40000 40001")
service = socket.create_server(("127.0.0.1", 5000))
taken = [socket.create_connection(("127.0.0.1", 5000)) for _ in range(2)]
accepted = [service.accept() for _ in taken]
try:
    socket.create_connection(("127.0.0.1", 5000))
except OSError as error:
    print(error.strerror)

def serve():
    asking, _ = service.accept()
    asking.recv(4096)
    asking.sendall(b'HTTP/1.1 200 OK\\r\\nconnection: close\\r\\n\\r\\n{"text": "it stands"}')
    asking.close()

threading.Thread(target=serve, daemon=True).start()
print(Client(parse_address("127.0.0.1:5000"), "t" * 43).command("stop").text)
"""


def test_a_stop_gets_through_where_a_flood_from_this_machine_has_used_up_all_ports_of_its_address():
    why = without_namespaces()
    if why:
        pytest.skip(why)
    command = ["unshare", "--net", sys.executable, "-c", ALL_TAKEN]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.splitlines() == ["Cannot assign requested address", "it stands"], done.stderr


@pytest.mark.parametrize(("name", "is_dropped"), [("auto", True), ("stop", False)])
def test_an_order_that_was_given_up_is_not_sent_on_once_the_network_is_back_unless_it_is_a_stop(
    monkeypatch, name, is_dropped
):
    monkeypatch.setattr(client, "_TIMEOUT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as service:
        address = parse_address("{}:{}".format(*service.getsockname()))
        with pytest.raises(NoServiceError, match="does not answer"):
            Client(address, "t" * 43).command(name)
        asking, _ = service.accept()
        with asking:
            asking.settimeout(60.0)
            try:
                while asking.recv(4096):
                    pass
                ended = "to the end"
            except ConnectionResetError:
                ended = "dropped"
        assert (ended == "dropped") is is_dropped
