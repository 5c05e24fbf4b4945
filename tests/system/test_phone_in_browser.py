"""Ten trackers on a phone: with large letters, lying on its side, and for a person who has only a keyboard."""

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

# A press near the edge of a button counts too.
IN_REACH = """button => {
  const { left, right, top, bottom } = button.getBoundingClientRect();
  const places = [[left + 9, top + 9], [right - 9, top + 9], [left + 9, bottom - 9], [right - 9, bottom - 9]];
  return places.every(([x, y]) => button.contains(document.elementFromPoint(x, y)));
}"""
IS_CUT = "button => button.scrollWidth > button.clientWidth || button.scrollHeight > button.clientHeight"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with browsers.fleet_site(tmp_path_factory.mktemp("site")) as found:
        yield found


def shown(context, site, view):
    page = browsers.Page(context, site.url, view)
    page.sees(".hero h1", "10 trackers" if view == "fleet" else "Tracking")
    return page


def test_with_letters_twice_as_large_no_button_is_cut_off_and_no_answer_covers_stop_or_the_tabs(browser, site):
    large = browsers.launch(browser.browser_type, "--blink-settings=defaultFontSize=32")
    try:
        page = shown(large.new_context(viewport={"width": 320, "height": 568}), site, "now")
        assert not page.page.locator("#who").evaluate(IS_CUT)
        page.page.locator("#who").click()
        page.log_in()
        for button in ("#stow", ".order.maintenance", ".order.home"):
            page.show("control")
            page.page.locator(button).click()
            assert not page.page.locator("dialog .go").evaluate(IS_CUT), button
            page.page.keyboard.press("Escape")
        page.page.locator("#stop").click()
        page.sees(".outcome", "mode hold: stopped by ana since ")
        for button in page.page.locator(".first button, .tabs a").all():
            assert button.evaluate(IN_REACH), "the answer lies over it"
        page.page.get_by_role("button", name="Dismiss this message").click()
        assert page.complaints == []
    finally:
        large.close()
        site.order("auto", tracker="t0")


# Tells the focused element if a bar covers its middle: a person at the keyboard would not see it.
IS_COVERED = """() => {
  const at = document.activeElement, { left, right, top, bottom } = at.getBoundingClientRect();
  const found = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
  return at !== document.body && !at.contains(found) && !found?.contains(at) && (at.innerText || at.name || at.id);
}"""


@pytest.mark.parametrize("viewport", [(320, 568), (640, 360)], ids=["upright", "as a desktop at 200 %"])
def test_while_the_keyboard_moves_through_a_view_no_bar_covers_the_focused_element(browser, site, viewport):
    with browser.new_context(viewport=dict(zip(("width", "height"), viewport, strict=True))) as context:
        page = shown(context, site, "control")
        covered = []
        for key in ["Tab"] * 24 + ["Shift+Tab"] * 24:
            page.page.keyboard.press(key)
            covered.append(page.page.evaluate(IS_COVERED))
        assert not any(covered), covered
        assert page.complaints == []


def test_on_a_phone_the_control_view_shows_each_order_once(browser, site):
    with browser.new_context(viewport=browsers.PHONE) as context:
        page = shown(context, site, "control")
        words = [text.split("\n")[0] for text in page.page.locator("button:visible").all_inner_texts()]
        assert {"Stop", "Stow", "Hold", "Auto", "Maintenance"} <= set(words)
        assert len(set(words)) == len(words), words


def test_with_forced_colours_buttons_and_the_tab_of_the_chosen_view_are_marked_by_borders(browser, site):
    with browser.new_context(viewport=browsers.PHONE, forced_colors="active") as context:
        page = shown(context, site, "control")
        for button in page.page.locator("button:visible").all():
            assert button.evaluate("node => getComputedStyle(node).borderTopStyle") != "none", button.inner_text()
        lines = "tabs => tabs.map((tab) => getComputedStyle(tab).borderTopWidth)"
        now, _, _, control = page.page.locator(".tabs a").evaluate_all(lines)
        assert float(control.removesuffix("px")) > float(now.removesuffix("px"))
        page.page.locator("#stow").click()
        yes = page.page.locator("dialog button[type=submit]")
        assert yes.evaluate("node => getComputedStyle(node).borderTopStyle") != "none"
