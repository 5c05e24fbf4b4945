"""An address, or the network of a group, that is missing on this machine at first, goes, and comes back."""

import asyncio
import logging
import socket
from dataclasses import dataclass, field

import pytest

from daemon.base.addresses import BridgeError
from daemon.base.clock import LoopClock
from daemon.base.timeloop import virtual_time
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.links import BridgeSettings
from tests.daemon.bridge.desk import KEY, UTC_S, scan, signed
from tests.support.addresses import SocketWithoutIpv6
from tests.support.bad_network import why_no_namespaces
from tests.support.own_network import add_address, in_own_network, remove_address

ADDRESS, PORT = "10.88.0.7", 20571
GROUP = "239.255.20.71"
LISTEN = BridgeSettings(listen=f"{ADDRESS}:{PORT}")
JOIN = BridgeSettings(
    listen=f"0.0.0.0:{PORT}", multicast_group=f"{GROUP}:{PORT}", multicast_interface=ADDRESS, send_to=()
)


@pytest.fixture(scope="module")
def _possible():
    if why := why_no_namespaces():
        pytest.skip(why)


@dataclass
class Listener:
    """A receiver in virtual time, and what it has heard and raised."""

    settings: BridgeSettings
    heard: list = field(default_factory=list)
    alarms: list = field(default_factory=list)

    def __post_init__(self):
        clock = LoopClock(asyncio.get_running_loop().time, UTC_S)
        self.receiver = BridgeReceiver(self.settings, KEY, clock, self.heard.append, None, self.alarm)
        self._number = -1

    def alarm(self, name, text):
        if (name, text) != (self.alarms or [("bridge-down", None)])[-1]:
            self.alarms.append((name, text))

    async def hears(self):
        """Send a scan to the address that the cube would use, and return whether it was heard."""
        self._number += 1
        before = len(self.heard)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as cube:
            to = ADDRESS
            if self.settings.multicast_group:
                to = GROUP
                cube.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(ADDRESS))
            cube.sendto(signed(scan(self._number, time_s=asyncio.get_running_loop().time())), (to, PORT))
            await asyncio.sleep(0.1)
        return len(self.heard) == before + 1


def run(scenario):
    def within():
        with virtual_time() as runner:
            runner.run(scenario())

    in_own_network(within)


@pytest.mark.usefixtures("_possible")
@pytest.mark.parametrize("settings", [LISTEN, JOIN], ids=["unicast", "group"])
def test_a_cube_is_heard_once_the_bridge_address_appears_and_again_after_it_was_gone(settings, caplog):
    async def scenario():
        listener = Listener(settings)
        listener.receiver.bind()
        await listener.receiver.open()
        await asyncio.sleep(59.0)
        assert f"{ADDRESS}" in listener.receiver.down_why
        assert listener.alarms == [], "a network that comes up with the machine is no alarm"
        await asyncio.sleep(6.0)
        ((name, text),) = listener.alarms
        assert name == "bridge-down"
        assert "is not an address of this machine" in text
        add_address(ADDRESS)
        await asyncio.sleep(5.1)
        assert listener.receiver.down_why is None
        assert await listener.hears()
        remove_address(ADDRESS)
        await asyncio.sleep(5.1)
        assert "is not an address of this machine" in listener.receiver.down_why
        add_address(ADDRESS)
        await asyncio.sleep(5.1)
        assert await listener.hears()
        assert len(listener.alarms) == 1, "what comes and goes is one alarm"
        await asyncio.sleep(65.0)
        assert listener.alarms[1:] == [("bridge-down", None)]
        await listener.receiver.close()

    with caplog.at_level(logging.INFO, "heliocube.bridge"):
        run(scenario)
    told = [line.getMessage() for line in caplog.records if line.getMessage().startswith("the bridge")]
    assert [text.partition(":")[0] for text in told] == [
        "the bridge is down",
        "the bridge is back",
        "the bridge is down",
        "the bridge is back",
    ]


@pytest.mark.usefixtures("_possible")
def test_the_bridge_waits_for_a_port_that_another_program_has_taken_meanwhile():
    async def scenario():
        listener = Listener(LISTEN)
        await listener.receiver.open()
        add_address(ADDRESS)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind((ADDRESS, PORT))
            with pytest.raises(BridgeError, match="in use by another program"):
                BridgeReceiver(LISTEN, KEY, LoopClock(asyncio.get_running_loop().time, UTC_S), print).bind()
            await asyncio.sleep(5.1)
            assert "in use by another program" in listener.receiver.down_why
        await asyncio.sleep(5.1)
        assert await listener.hears()
        await listener.receiver.close()

    run(scenario)


def test_an_ipv6_bridge_address_on_a_system_without_ipv6_is_refused_at_the_start(monkeypatch):
    monkeypatch.setattr(socket, "socket", SocketWithoutIpv6)
    receiver = BridgeReceiver(BridgeSettings(listen="[::1]:20571"), KEY, LoopClock(lambda: 0.0, UTC_S), print)
    with pytest.raises(BridgeError, match=r"\[::1\]:20571 cannot be bound \(Address family not supported"):
        receiver.bind()
