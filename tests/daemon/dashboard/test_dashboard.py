"""The dashboard between a browser and services."""

import asyncio
import json
import os

import pytest

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.process import SystemdNotifier
from daemon.dashboard.app import STATIC
from daemon.dashboard.serve import bind, serve, settings_of_file
from tests.daemon.dashboard.house import NAMES, OTHER, TOKEN, in_house


def test_the_page_and_all_its_files_are_served_under_a_strict_content_security_policy():
    async def scenario(house):
        page = await house.browser.get("/")
        assert page.status_code == 200
        policy = page.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        for path in sorted(STATIC.rglob("*")):
            if path.is_file():
                reply = await house.browser.get(f"/static/{path.relative_to(STATIC)}")
                assert reply.status_code == 200
                assert reply.headers["x-content-type-options"] == "nosniff"

    in_house(scenario)


@pytest.mark.parametrize("name", ["index.html", "style.css", "js/main.js", "vendor/uPlot.iife.min.js"])
def test_no_asset_of_the_page_refers_to_an_outside_address(name):
    text = (STATIC / name).read_text().replace("http://www.w3.org/2000/svg", "")
    assert "//cdn" not in text
    assert "http://" not in text.replace("https://github.com/leeoniya/uPlot", "")
    assert "https://" not in text.replace("https://github.com/leeoniya/uPlot", "")


@pytest.mark.parametrize(
    ("host", "taken"),
    [
        ("dash.lab", True),
        ("DASH.lab:20574", True),
        ("localhost:20574", True),
        ("127.0.0.1:20574", True),
        ("[::1]:20574", True),
        ("192.168.1.5", True),
        ("evil.example", False),
        ("dash.lab.evil.example", False),
        ("127.0.0.1.evil.example", False),
        ("", False),
        ("[", False),
        (None, True),
    ],
)
def test_a_request_for_a_foreign_host_name_is_refused(host, taken):
    async def scenario(house):
        request = house.browser.build_request("GET", "/", headers={"Host": host or ""})
        if host is None:
            del request.headers["Host"]
        reply = await house.browser.send(request)
        assert reply.status_code == (200 if taken else 403)
        if not taken:
            assert "dashboard.hosts" in reply.json()["error"]

    in_house(scenario)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://dash.lab", "http://dash.lab:1", "http://["])
def test_a_page_of_another_origin_cannot_give_an_order(origin):
    async def scenario(house):
        await house.login()
        reply = await house.browser.post(
            "/command", json={"name": "stow", "service": NAMES[0]}, headers={"Origin": origin}
        )
        assert reply.status_code == 403
        del house.browser.headers["Origin"]
        assert (await house.order()).status_code == 403
        assert house.services[NAMES[0]].asked == []

    in_house(scenario)


def test_an_order_goes_to_the_service_with_its_token_and_the_name_of_whoever_logged_in():
    async def scenario(house):
        assert (await house.order()).status_code == 401
        reply = await house.login()
        assert reply.json() == {"by": "ana", "services": [NAMES[0]]}
        cookie = reply.headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=strict" in cookie
        assert TOKEN not in cookie
        done = await house.order("goto", a_deg=-10, b_deg=60, tracker="east", by="mallory")
        assert done.json()["text"] == "/api/goto done"
        sent = {"a_deg": -10, "b_deg": 60, "tracker": "east", "by": "ana"}
        assert house.services[NAMES[0]].asked == [("/api/goto", sent)]

    in_house(scenario)


def test_a_service_with_another_token_asks_for_its_own_token_and_both_logins_are_kept():
    async def scenario(house):
        await house.login()
        refused = await house.order(service=NAMES[1])
        assert (refused.status_code, refused.json()["error"]) == (
            401,
            "the service at 127.0.0.1:1002 has another token: log in with that token too",
        )
        assert (await house.login(OTHER)).json()["services"] == list(NAMES)
        assert (await house.order(service=NAMES[1])).status_code == 200
        assert (await house.order(service=NAMES[0])).status_code == 200

    in_house(scenario)


def test_a_service_that_was_away_at_the_login_gets_orders_with_the_token_that_the_others_took():
    async def scenario(house):
        away = house.services[NAMES[1]]
        away.gone = True
        assert sorted((await house.login()).json()["services"]) == list(NAMES)
        found = (await house.browser.post("/stow-all", json={})).json()["results"]
        assert [(each["status"], each["text"]) for each in found] == [
            (200, "/api/stow done"),
            (502, "the service does not answer"),
        ]
        away.gone = False
        refused = await house.order(service=NAMES[1])
        assert (refused.status_code, refused.json()["error"]) == (
            401,
            "the service at 127.0.0.1:1002 takes another token now: log in with that token",
        )
        assert (await house.browser.get("/session")).json()["services"] == [NAMES[0]]
        assert sorted((await house.login(OTHER)).json()["services"]) == list(NAMES)
        away.gone = True
        await house.login()
        away.gone = False
        assert (await house.order(service=NAMES[1])).status_code == 200

    in_house(scenario)


def test_stow_for_all_reports_the_result_of_each_service():
    async def scenario(house):
        await house.login()
        await house.login(OTHER)
        house.services[NAMES[1]].refusal = "not in reach"
        found = (await house.browser.post("/stow-all", json={"why": "hail"})).json()["results"]
        assert found == [
            {"service": NAMES[0], "accepted": True, "status": 200, "text": "/api/stow done"},
            {"service": NAMES[1], "accepted": False, "status": 409, "text": "not in reach"},
        ]
        assert house.services[NAMES[0]].asked == [("/api/stow", {"why": "hail", "by": "ana"})]
        house.services[NAMES[0]].gone = True
        found = (await house.browser.post("/stow-all", json={})).json()["results"]
        assert found[0]["text"] == "the service does not answer"
        house.services[NAMES[1]].token = "n" * 43
        found = (await house.browser.post("/stow-all", json={})).json()["results"]
        assert [each["status"] for each in found] == [502, 401]

    in_house(scenario)


def test_stop_for_all_reaches_every_service_however_late_and_needs_a_login():
    async def scenario(house):
        assert (await house.browser.post("/stop-all", json={})).status_code == 401
        await house.login()
        await house.login(OTHER)
        house.services[NAMES[1]].refusal = "not in reach"
        found = (await house.browser.post("/stop-all", json={"given_s": 0.0})).json()["results"]
        assert [(each["accepted"], each["text"]) for each in found] == [
            (True, "/api/stop done"),
            (False, "not in reach"),
        ]
        assert [service.asked for service in house.services.values()] == [[("/api/stop", {"by": "ana"})]] * 2

    in_house(scenario)


def test_stow_for_all_leaves_out_a_process_while_it_is_known_to_read_only_a_cube():
    async def scenario(house):
        cube = house.services[NAMES[1]]
        cube.token = TOKEN
        await house.login()
        cube.states = ['{"version": "1", "role": "cube", "trackers": {}}']
        cube.refusal = "this process reads the cube and has no tracker: ask the tracker's process"
        following = asyncio.create_task(house.fleet.run())
        with house.fleet.listening() as listener:
            while not any('"role": "cube"' in message for message in await listener.next()):
                pass
            found = (await house.browser.post("/stow-all", json={})).json()["results"]
            assert [(each["service"], each["accepted"]) for each in found] == [(NAMES[0], True)]
            cube.gone = True
            cube.ends.set()
            while not any('"up": false' in message for message in await listener.next()):
                pass
        # A service that comes back may have a tracker.
        found = (await house.browser.post("/stow-all", json={})).json()["results"]
        assert [each["status"] for each in found] == [200, 502]
        following.cancel()
        await asyncio.wait((following,))

    in_house(scenario)


def test_wrong_tokens_are_refused_in_a_sentence_and_not_tried_for_ever():
    async def scenario(house):
        for given, status, words in [
            ({"token": TOKEN, "by": ""}, 400, "say who you are"),
            ({"token": TOKEN, "by": "a\nb"}, 400, "say who you are"),
            ({"token": "short", "by": "ana"}, 400, "that is not a token"),
            ({"token": 7, "by": "ana"}, 400, "that is not a token"),
        ]:
            reply = await house.browser.post("/login", json=given)
            assert (reply.status_code, words in reply.json()["error"]) == (status, True)
        for _ in range(5):
            assert (await house.login("x" * 40)).status_code == 401
        assert (await house.login()).status_code == 429
        assert (await house.browser.get("/session")).json() == {"by": None, "services": []}

    in_house(scenario)


def test_no_token_can_be_tried_while_no_service_answers():
    async def scenario(house):
        for service in house.services.values():
            service.gone = True
        reply = await house.login()
        assert (reply.status_code, reply.json()["error"]) == (
            502,
            "no service answers now, so the token cannot be tried",
        )

    in_house(scenario)


def test_opening_the_page_renews_the_30_days_of_the_session_cookie():
    async def scenario(house):
        assert "set-cookie" not in (await house.browser.get("/session")).headers
        given = (await house.login()).headers["set-cookie"]
        assert "Max-Age=2592000" in given
        assert (await house.browser.get("/session")).headers["set-cookie"] == given
        assert (await house.order()).status_code == 200

    in_house(scenario)


def test_logging_out_ends_the_session_for_whoever_has_the_cookie():
    async def scenario(house):
        await house.login()
        ((cookie, stolen),) = house.browser.cookies.items()
        await house.browser.post("/logout")
        house.browser.cookies.set(cookie, stolen)
        assert (await house.order()).status_code == 401

    in_house(scenario)


def test_dashboards_on_one_host_have_separate_logins():
    async def scenario(house):
        await house.login()
        for port in ("20575", "20576"):
            there = f"http://dash.lab:{port}"
            login = {"token": TOKEN, "by": "ben"}
            reply = await house.browser.post(f"{there}/login", json=login, headers={"Origin": there})
            assert reply.json()["by"] == "ben"
            assert (await house.browser.get("/session")).json()["by"] == "ana"
        await house.browser.post("http://dash.lab:20575/logout", headers={"Origin": "http://dash.lab:20575"})
        assert (await house.browser.get("http://dash.lab:20576/session")).json()["by"] == "ben"

    in_house(scenario)


def test_unknown_commands_services_and_readings_are_refused():
    async def scenario(house):
        await house.login()
        assert (await house.order("../../evil")).status_code == 400
        assert (await house.order(service="10.0.0.1:80")).status_code == 404
        assert (await house.browser.get("/read/state", params={"service": NAMES[0]})).status_code == 404
        assert (await house.browser.get("/read/sun", params={"service": "10.0.0.1:80"})).status_code == 404
        reply = await house.browser.get("/read/sun", params={"service": NAMES[0], "at": "2022-10-14"})
        assert reply.headers["content-encoding"] == "gzip"
        assert reply.json() == {"at": "2022-10-14"}
        house.services[NAMES[0]].gone = True
        assert (await house.order()).json() == {"error": "the service cannot be reached"}

    in_house(scenario)


def test_every_browser_gets_the_newest_state_of_each_service_whenever_it_connects():
    async def scenario(house):
        following = asyncio.create_task(house.fleet.run())
        try:
            with house.fleet.listening() as early:
                messages = {}
                while not all(message.get("up") for message in messages.values()) or len(messages) < 2:
                    for text in await early.next():
                        messages[json.loads(text)["service"]] = json.loads(text)
                assert messages[NAMES[0]]["state"] == {"version": "1", "trackers": {}}
                with house.fleet.listening() as late:
                    assert [json.loads(text)["up"] for text in await late.next()] == [True, True]
                    assert house.fleet.listeners == 2
                house.services[NAMES[1]].gone = True
                house.services[NAMES[1]].ends.set()
                (text,) = await early.next()
                assert json.loads(text)["up"] is False
                assert json.loads(text)["why"] == "has ended the connection"
                (text,) = await early.next()
                assert json.loads(text)["why"] == "is not running, or listens elsewhere"
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)

    in_house(scenario)


def test_for_a_browser_that_does_not_read_only_one_message_of_each_service_is_held():
    async def scenario(house):
        service = house.services[NAMES[0]]
        service.states = [f'{{"n": {n}}}' for n in range(1000)]
        following = asyncio.create_task(house.fleet.run())
        try:
            with house.fleet.listening() as slow, house.fleet.listening() as other:
                while '"n": 999' not in "".join(await other.next()):
                    pass
                assert len(await slow.next()) == 2
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)

    in_house(scenario)


@pytest.mark.parametrize("text", ["<html>", '{"a_deg": NaN}', "[" * 100_000])
def test_a_message_that_is_no_valid_state_never_reaches_a_browser(text):
    async def scenario(house):
        house.services[NAMES[0]].states = [text]
        following = asyncio.create_task(house.fleet.run())
        try:
            with house.fleet.listening() as listener:
                seen = ""
                while "does not speak as heliocube does" not in seen:
                    seen = "".join(await listener.next())
                assert text not in seen
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)

    in_house(scenario)


def test_the_dashboard_ends_when_following_the_services_fails_instead_of_showing_an_old_state(monkeypatch):
    def broken(*_, **__):
        raise LookupError("a defect of a library")

    monkeypatch.setattr("daemon.dashboard.upstream.aconnect_sse", broken)
    bound = bind("127.0.0.1:0")
    notifier = SystemdNotifier({}, os.getpid())
    ends = asyncio.wait_for(serve(bound, [parse_address("127.0.0.1:9")], [], SystemClock(), notifier), 20.0)
    with pytest.raises(ExceptionGroup) as ended:
        asyncio.run(ends)
    assert ended.group_contains(LookupError)


def test_the_dashboard_uses_the_services_of_its_file_or_else_the_one_at_the_api_address(tmp_path):
    assert settings_of_file(None).services == ("127.0.0.1:20572",)
    file = tmp_path / "x.toml"
    file.write_text('[api]\nlisten = "0.0.0.0:4000"\n')
    assert settings_of_file(file).services == ("127.0.0.1:4000",)
    file.write_text('[dashboard]\nservices = ["10.0.0.1:20572", "10.0.0.2:20572"]\n[law]\ndriver = "wrong"\n')
    assert settings_of_file(file).services == ("10.0.0.1:20572", "10.0.0.2:20572")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[dashboard]\nlisten = 7\n", "the [dashboard] of"),
        ('[api]\nlisten = "here"\n', "the [api] of"),
        ("[dashboard\n", "is not TOML"),
    ],
)
def test_a_wrong_configuration_file_is_refused_naming_the_wrong_section(tmp_path, text, words):
    file = tmp_path / "x.toml"
    file.write_text(text)
    with pytest.raises(UserError, match="heliocube config check") as caught:
        settings_of_file(file)
    assert words in str(caught.value).replace("\\", "")


def test_a_port_that_is_taken_is_reported_with_its_likely_cause():
    with bind("127.0.0.1:0") as first:
        port = first.getsockname()[1]
        with pytest.raises(UserError, match="is another dashboard running"):
            bind(f"127.0.0.1:{port}")
