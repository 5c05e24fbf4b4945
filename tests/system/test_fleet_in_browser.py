"""The view of all trackers in a real browser."""

import re

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import MadeSite  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

NOON = 1663761600.0
"""2022-09-21T12:00Z."""
LINES = """cell => {
  const text = document.createRange();
  text.selectNodeContents(cell);
  return text.getClientRects().length;
}"""


@pytest.mark.parametrize("width", [360, 390, 430])
def test_on_a_phone_the_mode_of_a_tracker_is_not_broken_across_lines(browser, tmp_path, width):
    with browser.new_context(viewport={"width": width, "height": 800}) as context:
        page = MadeSite(tmp_path).open(context, NOON, "maintenance")
        page.show("fleet")
        page.sees(".fleet td", "maintenance")
        assert page.page.locator(".fleet td").first.evaluate(LINES) == 1
        assert page.page.evaluate("document.documentElement.scrollWidth") == width
        assert page.complaints == []


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with browsers.fleet_site(tmp_path_factory.mktemp("site")) as found:
        yield found


def stopped_by(site):
    return {
        name: tracker["wishes"]["stop"]["by"]
        for name, tracker in site.state()["trackers"].items()
        if tracker["wishes"]["stop"]
    }


@pytest.mark.parametrize("viewport", [browsers.PHONE, browsers.DESKTOP], ids=["phone", "desktop"])
def test_after_stop_all_auto_releases_one_tracker_at_a_time_and_never_a_stop_that_was_not_shown(
    browser, site, viewport
):
    with browser.new_context(viewport=viewport) as context:
        page = browsers.Page(context, site.url, "fleet")
        page.sees(".hero h1", "10 trackers")
        autos = page.page.locator(".fleet .release button:visible")
        page.page.get_by_role("button", name="Stop all").click()
        page.log_in()
        page.sees(".hero .why", "10 stopped")
        assert page.text(".fleet td") == "stopped", "as 'tracking' and 'hold' stand there"
        playwright.expect(autos).to_have_count(10)
        page.page.get_by_role("button", name="Auto t7, SIRTA").click()
        page.sees("dialog .wish", "Stopped by ana since ")
        # Somebody else stops it while the question is read.
        site.order("stop", tracker="t7", by="ben", why="a hand")
        page.page.get_by_role("button", name="Auto now").click()
        page.sees(
            ".outcome",
            "Auto was given before the wish that it would end, so give it again; the tracker is stopped by ana",
        )
        page.sees(".outcome", "also by ben")
        assert stopped_by(site) == {f"t{number}": "ana" for number in range(10)}
        page.page.wait_for_function("() => document.querySelectorAll('.fleet td')[7 * 9].title.includes('also by ben')")
        page.page.get_by_role("button", name="Auto t7, SIRTA").click()
        page.sees("dialog .wish", "Stopped by ana since ")
        page.sees("dialog .wish", "Also by ben since ")
        page.sees("dialog .wish", ": a hand.")
        page.page.get_by_role("button", name="Auto now").click()
        page.sees(".hero .why", "9 stopped, 1 tracking")
        assert "t7" not in stopped_by(site)
        playwright.expect(autos).to_have_count(9)
        assert page.page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
        assert page.complaints == []
    for name in stopped_by(site):
        site.order("auto", tracker=name)


def test_the_result_of_an_order_to_all_is_still_shown_after_a_visit_to_another_view(browser, site):
    with browser.new_context(viewport=browsers.DESKTOP) as context:
        page = browsers.Page(context, site.url, "fleet")
        page.sees(".hero h1", "10 trackers")
        text = "NOT done by 1 of 10 trackers, t3:\n  t3: a fault"
        refusal = {"service": site.api, "accepted": False, "status": 409, "text": text}
        page.page.route("**/stow-all", lambda route: route.fulfill(json={"results": [refusal]}))
        page.page.get_by_role("button", name="Stow all").click()
        page.log_in()
        page.page.get_by_role("button", name="Stow now").click()
        page.sees(".outcome", "Stow was NOT taken by 1 of 1 services: see the list")
        page.show("now")
        page.sees(".hero h1", "Tracking")
        page.show("fleet")
        page.sees(".results", re.compile(r":\d+: NOT done by 1 of 10 trackers, t3:\s+t3: a fault"))
        page.sees(".results", "Stow all, ")
        page.sees(".hero .moving", "0 of 10 stand stowed, ")
        assert page.complaints == []
