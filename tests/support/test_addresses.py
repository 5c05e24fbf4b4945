import socket
import subprocess
import sys
from pathlib import Path

from tests.support import ROOT
from tests.support.addresses import free_port

OTHER = "from tests.support.addresses import free_port; print(*(free_port() for _ in range(40)))"


def test_no_free_port_is_given_twice_in_a_row_or_to_another_process_too():
    own = [free_port() for _ in range(30)]
    other = subprocess.run([sys.executable, "-c", OTHER], cwd=ROOT, capture_output=True, text=True, check=True)
    assert len(set(own)) == 30
    assert not set(own) & set(map(int, other.stdout.split()))
    assert max(own) < int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])


def test_a_port_in_use_is_not_given_as_free():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port()))
        assert taken.getsockname()[1] not in {free_port() for _ in range(60)}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", free_port(socket.SOCK_DGRAM)))
