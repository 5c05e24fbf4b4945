"""Fixtures for tests that start real processes."""

import socket

import pytest


@pytest.fixture
def free_udp_port():
    """A UDP port on loopback that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
