"""The command line's connection to the service where the network is bad."""

import asyncio
import socket
import subprocess
import sys

import pytest

from daemon.api import client
from daemon.api.client import Client, CommandRefusedError, NoServiceError, find_service, find_without_token
from daemon.base.addresses import parse_address
from daemon.base.errors import UserError
from daemon.base.records import Mode
from tests.support import PATIENCE_S
from tests.support.api import TOKEN
from tests.support.bad_network import why_no_namespaces
from tests.support.phases import wait_for_tracking

# One address has only two ports here; two connections of another program take both.
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


def test_a_stop_gets_through_when_all_local_ports_of_its_address_are_used_up():
    why = why_no_namespaces()
    if why:
        pytest.skip(why)
    command = ["unshare", "--net", sys.executable, "-c", ALL_TAKEN]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.stdout.splitlines() == ["Cannot assign requested address", "it stands"], done.stderr


@pytest.mark.parametrize(("name", "is_dropped"), [("auto", True), ("stop", False)])
def test_a_command_that_timed_out_is_not_delivered_later_unless_it_is_a_stop(monkeypatch, name, is_dropped):
    monkeypatch.setattr(client, "_TIMEOUT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as service:
        address = parse_address("{}:{}".format(*service.getsockname()))
        with pytest.raises(NoServiceError, match="does not answer"):
            Client(address, "t" * 43).command(name)
        asking, _ = service.accept()
        with asking:
            asking.settimeout(PATIENCE_S)
            try:
                while asking.recv(4096):
                    pass
                ended = "to the end"
            except ConnectionResetError:
                ended = "dropped"
        assert (ended == "dropped") is is_dropped


def test_a_copied_configuration_reaches_no_other_tracker_and_its_stop_names_the_stopped_one(serve, tmp_path):
    roof, copy, link = (tmp_path / name for name in ("roof.toml", "copy.toml", "link.toml"))

    async def scenario(rig, call):
        await wait_for_tracking(rig)
        listen = call.server.url.removeprefix("http://")
        for file in (roof, copy):
            file.write_text(f'[api]\nlisten = "{listen}"\n[mqtt]\nname = "tracker"\n', encoding="utf-8")
        link.symlink_to(roof)

        elsewhere = rf"api.listen of {copy} leads to the service of {roof} \(tracker tracker\)"
        wrong = find_service(copy, None, None, {"HELIOCUBE_TOKEN": TOKEN})
        with pytest.raises(NoServiceError, match=f"^nothing is done: {elsewhere}; give"):
            await asyncio.to_thread(wrong.command, "hold")
        assert rig.control.mode is Mode.TRACKING
        for look in (wrong.state, wrong.health):
            with pytest.raises(NoServiceError, match=f"^{elsewhere}; give"):
                await asyncio.to_thread(look)
        for right in (find_without_token(roof, None), find_without_token(link, None), find_without_token(copy, listen)):
            assert (await asyncio.to_thread(right.state))["mode"]["name"] == "tracking"
        # The client's thread lets no virtual time pass, which telemetry needs.
        reply = await call.post(f"stop?configuration={copy}")
        assert (reply.status, rig.control.wishes.stop is not None) == (421, True)
        assert reply.json["error"].startswith(f"the tracker of {copy} was NOT stopped: its api.listen leads to ")
        assert f"service of {roof} (tracker tracker), which was told to stop instead: stopped on " in str(reply.json)
        assert (await call.post(f"auto?configuration={copy}&configuration={roof}")).status == 200

    serve(scenario, file=roof)


@pytest.mark.parametrize(("name", "undone"), [("hold", "nothing is done"), ("stop", "nothing was stopped")])
def test_a_wrong_token_in_a_copied_configuration_does_not_hide_whose_service_answers(serve, tmp_path, name, undone):
    roof, copy = tmp_path / "roof.toml", tmp_path / "copy.toml"

    async def scenario(rig, call):
        listen = call.server.url.removeprefix("http://")
        for file in (roof, copy):
            file.write_text(f'[api]\nlisten = "{listen}"\n[mqtt]\nname = "tracker"\n', encoding="utf-8")
        strangers = {"HELIOCUBE_TOKEN": "s" * 43}
        elsewhere = rf"^{undone}: api.listen of {copy} leads to the service of {roof} \(tracker tracker\); give"
        with pytest.raises(NoServiceError, match=elsewhere):
            await asyncio.to_thread(find_service(copy, None, None, strangers).command, name)
        with pytest.raises(CommandRefusedError, match="the token is not the service's"):
            await asyncio.to_thread(find_service(roof, None, None, strangers).command, name)

    serve(scenario, file=roof)


def test_a_file_with_only_an_api_address_may_lead_to_any_service(tmp_path):
    file = tmp_path / "way.toml"
    file.write_text('[api]\nlisten = "127.0.0.1:20572"\n', encoding="utf-8")
    assert find_without_token(file, None).configuration == ()


def test_refusal_for_a_given_file_without_a_token_file_does_not_advise_the_config_option(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text('[api]\nlisten = "127.0.0.1:1"\n[bridge]\n')
    with pytest.raises(UserError) as refused:
        find_service(file, None, None, {}).command("stop")
    told = str(refused.value)
    assert told.startswith(f"'stop' needs the service's token, and {file} has no api.token_file: give the token that ")
    assert "--config" not in told


def test_a_token_file_in_an_unknown_users_home_is_refused_in_one_sentence(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text('[api]\ntoken_file = "~nobody-of-that-name/api.token"\n')
    with pytest.raises(UserError, match=f"^api.token_file in {file}: .*home"):
        find_service(file, None, None, {})
