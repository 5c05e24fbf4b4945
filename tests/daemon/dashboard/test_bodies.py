"""What comes with an order: nonsense is refused, and what is merely odd is left for the service to judge."""

import math
import sys
import time

import httpx
import pytest

from daemon.service.operator_commands import LONGEST_BODY
from tests.daemon.dashboard.house import NAMES, in_house


@pytest.mark.parametrize(
    ("body", "status"), [("[]", 400), ("{", 400), ("[" * 3000, 400), ('{"a": "' + "x" * 5000 + '"}', 413)]
)
def test_a_request_body_that_is_no_object_or_is_too_long_is_refused(body, status):
    async def scenario(house):
        reply = await house.browser.post("/login", content=body)
        assert (reply.status_code, "error" in reply.json()) == (status, True)

    in_house(scenario)


@pytest.mark.parametrize("words", [r'"\ud800"', "NaN", "-1e999", "[" * 500 + "]" * 500, '"' + "\N{SUN}" * 1100 + '"'])
def test_an_order_with_odd_values_is_handed_on_for_the_service_to_judge(words):
    async def scenario(house):
        await house.login()
        body = f'{{"service": "{NAMES[0]}", "name": "stop", "why": {words}}}'
        assert (await house.browser.post("/command", content=body)).status_code == 200
        found = (await house.browser.post("/stow-all", content=f'{{"why": {words}}}')).json()["results"]
        assert [(each["accepted"], each["text"]) for each in found] == [
            (True, "/api/stow done"),
            (False, "the service at 127.0.0.1:1002 has another token: log in with that token too"),
        ]
        assert [path for path, _ in house.services[NAMES[0]].asked] == ["/api/stop", "/api/stow"]

    in_house(scenario)


@pytest.mark.parametrize("why", ['"%s"' % ("x" * 3500), "[1%s]" % (",1" * 1750), '"%s"' % (r"\n" * 1750)])
def test_an_order_that_the_dashboard_takes_is_not_too_long_for_the_service(monkeypatch, why):
    async def scenario(house):
        sent = []

        def answer(request):
            sent.append(len(request.content))
            return httpx.Response(200, json={"text": "done"})

        monkeypatch.setattr(house.services[NAMES[0]], "answer", answer)
        for by in ("\N{SUN WITH FACE}" * 60, '"' * 60):
            assert (await house.login(by=by)).status_code == 200
            for more in range(0, 600, 20):
                order = f'{{"service":"{NAMES[0]}","name":"stow","id":"{"x" * more}","why":{why}}}'
                assert (await house.browser.post("/command", content=order)).status_code in (200, 413)
        assert LONGEST_BODY - 600 < max(sent) <= LONGEST_BODY

    in_house(scenario)


def test_a_body_that_is_read_but_too_deep_to_hand_on_is_refused(monkeypatch):
    async def scenario(house):
        await house.login()
        monkeypatch.setattr(house.services[NAMES[0]], "answer", lambda _: httpx.Response(200, json={"text": "done"}))
        found = set()
        # How deeply nested a body can be depends on Python's version; from 3.13 on any depth within the allowed length.
        for deep in (*range(850, 1000), *range(1400, 1550)):
            body = f'{{"service": "{NAMES[0]}", "name": "stop", "why": {"[" * deep}{"]" * deep}}}'
            found.add((await house.browser.post("/command", content=body)).status_code)
        assert found == ({200, 400} if sys.version_info < (3, 13) else {200})

    in_house(scenario)


def test_an_order_answered_by_a_program_that_is_no_heliocube_service_is_reported_as_failed(monkeypatch):
    async def scenario(house):
        await house.login()
        for answer in (b"<html>", b"[]", b"{}"):
            monkeypatch.setattr(
                house.services[NAMES[0]], "answer", lambda _, text=answer: httpx.Response(200, content=text)
            )
            found = (await house.browser.post("/stow-all", json={})).json()["results"]
            sentence = "the program that answers is not a service of heliocube: see dashboard.services"
            assert found[0] == {"service": NAMES[0], "accepted": False, "status": 502, "text": sentence}
            reply = await house.order()
            assert (reply.status_code, reply.json()) == (502, {"error": sentence})

    in_house(scenario)


@pytest.mark.parametrize(
    ("ago_s", "taken"), [(41.0, False), (math.nan, False), (10**400, False), (30.0, True), (-(10**400), True)]
)
def test_an_order_more_than_40_s_old_is_refused_unless_it_is_a_stop(ago_s, taken):
    async def scenario(house):
        await house.login()
        given_s = -ago_s if isinstance(ago_s, int) else time.monotonic() - ago_s
        words = f'{{"service": "{NAMES[0]}", "given_s": {given_s}, "name": '.replace("nan", "NaN")
        for path, name in (("/command", "goto"), ("/stow-all", "stow")):
            reply = await house.browser.post(path, content=f'{words}"{name}"}}')
            assert reply.status_code == (200 if taken else 409)
            assert taken or "more than 40 s after it was given" in reply.json()["error"]
        assert len(house.services[NAMES[0]].asked) == 2 * taken
        assert (await house.browser.post("/command", content=f'{words}"stop"}}')).status_code == 200
        assert house.services[NAMES[0]].asked[-1] == ("/api/stop", {"by": "ana"})

    in_house(scenario)
