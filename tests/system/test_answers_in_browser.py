"""What the page says of several orders while one waits for its answer, and of a page that has to be opened anew."""

import pytest

from tests.system.processes import wait_until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import MadeSite  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with browsers.simulated_site(tmp_path_factory.mktemp("site")) as found:
        yield found


@pytest.fixture
def page(browser, site):
    with browser.new_context(viewport=browsers.PHONE) as context:
        found = browsers.Page(context, site.url, "control")
        found.sees(".hero h1", "Tracking")
        found.page.locator("#who").click()
        found.log_in()
        yield found
        assert found.complaints == []
    wait_until(lambda: site.order("auto").get("accepted"), site.service.log)
    site.until_mode("tracking")


def test_the_late_answer_to_an_order_does_not_hide_the_answer_to_a_later_one(page):
    held = []
    page.page.route("**/command", lambda route: held.append(route), times=1)
    page.page.locator(".order.hold").click()
    page.sees(".outcome", "Hold: sent to tracker, SIRTA ...")
    page.page.locator("#stop").click()
    page.sees(".outcome", "mode hold: stopped by ana")
    assert "Hold: sent to tracker, SIRTA ..." in page.text(".outcome"), "it is under way still"
    held[0].continue_()
    page.sees(".outcome", "Hold for tracker, SIRTA: No hold: the tracker is stopped by ana")
    assert "mode hold: stopped by ana" in page.text(".outcome")
    assert page.page.locator(".outcome").get_attribute("data-kind") == "bad"
    page.page.locator("#stop").click()
    page.sees(".outcome", "Stop for tracker, SIRTA: standing at ")
    assert page.page.locator(".outcome p").count() == 1, "what is answered makes room"
    assert page.page.locator(".outcome").get_attribute("data-kind") == "ok"


def test_the_page_is_not_reloaded_for_a_new_version_while_a_dialog_is_being_answered(browser, tmp_path):
    with browser.new_context(viewport=browsers.PHONE) as context:
        page = MadeSite(tmp_path).open(context, 1663761600.0)
        page.sees("#stop", "Stop")
        page.page.locator("#stow").click()
        page.page.get_by_label("Token").fill("half of it")
        page.page.evaluate("window.page = 'another'")
        page.page.wait_for_timeout(3000)
        assert page.page.get_by_label("Token").input_value() == "half of it"
        with page.page.expect_event("load"):
            page.page.get_by_role("button", name="Cancel").click()
        page.sees("#stop", "Stop")
        assert page.complaints == []


def test_a_login_on_a_slow_line_is_sent_once_and_says_that_it_is_under_way(browser, site):
    with browser.new_context(viewport=browsers.PHONE) as context:
        page = browsers.Page(context, site.url)
        page.sees(".hero h1", "Tracking")
        held = []
        page.page.route("**/login", lambda route: held.append(route))
        page.page.locator("#who").click()
        dialog = page.page.get_by_role("dialog")
        dialog.get_by_label("Your name").fill("ana")
        dialog.get_by_label("Token").fill(browsers.TOKEN)
        for _ in range(3):
            dialog.get_by_role("button", name="Log in").click()
        dialog.get_by_label("Token").press("Enter")
        page.sees("dialog [role=alert]", "The token is being tried ...")
        assert len(held) == 1, "five wrong ones in a minute keep everybody out"
        held[0].continue_()
        page.sees("#who", "ana")
        assert page.complaints == []
