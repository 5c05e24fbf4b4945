"""The view of all trackers in a real browser."""

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
def test_on_a_phone_no_mode_is_broken_within_its_word(browser, tmp_path, width):
    with browser.new_context(viewport={"width": width, "height": 800}) as context:
        page = MadeSite(tmp_path).open(context, NOON, "maintenance")
        page.show("fleet")
        page.sees(".fleet td", "maintenance")
        assert page.page.locator(".fleet td").first.evaluate(LINES) == 1
        assert page.page.evaluate("document.documentElement.scrollWidth") == width
        assert page.complaints == []
