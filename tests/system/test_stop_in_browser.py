"""Stop in a real browser: in reach in every view, covered by nothing, and done at once."""

import re

import pytest

from tests.system.processes import wait_until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

VIEWS = {"now": ".equipment td", "day": ".day .log li", "fleet": ".fleet td", "control": ".order.auto"}
# Without the date: it is today by the service's clock, though not by that of the reader.
ANSWER = re.compile(r"mode hold: stopped by ana since \d\d:\d\d.local")
SMALL = {"width": 360, "height": 740}
# A press near the edge of a button counts too.
IN_REACH = """button => {
  const { left, right, top, bottom } = button.getBoundingClientRect();
  const places = [[left + 9, top + 9], [right - 9, top + 9], [left + 9, bottom - 9], [right - 9, bottom - 9]];
  return places.every(([x, y]) => button.contains(document.elementFromPoint(x, y)));
}"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with browsers.simulated_site(tmp_path_factory.mktemp("site")) as found:
        yield found


@pytest.fixture
def auto(site):
    """Return a function that ends all orders; they end with the test, too."""

    def end():
        wait_until(lambda: site.order("auto").get("accepted"), site.service.log)
        site.until_mode("tracking")

    yield end
    end()


@pytest.fixture
def context(browser):
    with browser.new_context(viewport=SMALL) as found:
        yield found


def logged_in(context, site):
    page = browsers.Page(context, site.url)
    page.sees(".hero h1", "Tracking")
    page.page.locator("#who").click()
    page.log_in()
    return page


def pressed(page, name):
    """Press where a person sees the button."""
    box = page.page.get_by_role("button", name=name, exact=True).bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


ENDS_ABOVE_ORDERS = """() => {
  const place = (selector) => document.querySelector(selector).getBoundingClientRect();
  scrollTo(0, 1e6);
  return place("main").bottom <= place(".first").top + 1;
}"""


@pytest.mark.parametrize("viewport", [SMALL, browsers.TABLET, browsers.DESKTOP], ids=["phone", "tablet", "desktop"])
def test_every_view_has_a_stop_button_that_nothing_covers_and_that_acts_at_once(context, site, auto, viewport):
    page = logged_in(context, site)
    page.page.set_viewport_size(viewport)
    for view, shown in VIEWS.items():
        page.show(view)
        page.page.wait_for_selector(shown)
        # At the top of the view and at its end.
        for place in (0, 1e6):
            page.page.evaluate("place => scrollTo(0, place)", place)
            assert page.page.locator("#stop").evaluate(IN_REACH), view
            assert page.page.locator("#stow").evaluate(IN_REACH), view
        pressed(page, "Stop tracker, SIRTA")
        page.sees(".outcome", ANSWER)
        assert site.state()["wishes"]["stop"]["by"] == "ana"
        assert page.page.locator("#stop").evaluate(IN_REACH), "its own answer does not lie over it"
        auto()
    assert page.complaints == []


def test_on_a_phone_the_bar_of_orders_hides_neither_the_end_of_a_view_nor_the_tabs(context, site):
    page = browsers.Page(context, site.url)
    for view, shown in VIEWS.items():
        page.show(view)
        page.page.wait_for_selector(shown)
        # Until it holds: text that comes meanwhile makes the view longer.
        page.page.wait_for_function(ENDS_ABOVE_ORDERS)
        assert page.page.locator(".tabs a").evaluate_all(f"tabs => tabs.every({IN_REACH})")


def test_with_several_trackers_stop_names_and_stops_the_selected_one_and_stop_all_stops_every_one(browser, tmp_path):
    with browsers.fleet_site(tmp_path) as site, browser.new_context(viewport=SMALL) as context:
        page = browsers.Page(context, site.url)
        page.sees("#tracker", "t7")
        page.page.locator("#tracker").select_option(label="t7, SIRTA")
        page.show("fleet")
        page.sees(".fleet td", "tracking")
        assert page.text("#stop").split() == ["Stop", "t7,", "SIRTA"]
        pressed(page, "Stop t7, SIRTA")
        page.log_in()
        page.sees(".outcome", ANSWER)
        stopped = [name for name, tracker in site.state()["trackers"].items() if tracker["wishes"]["stop"]]
        assert stopped == ["t7"]
        pressed(page, "Stop all")
        page.sees(".outcome", "Stop was taken by the service.")
        page.sees(".results", re.compile(r"all 10 trackers:\s+t0: .* stopped by ana since \d\d:\d\d.local"))
        page.sees(".hero .why", "10 stopped")
        assert all(tracker["wishes"]["stop"] for tracker in site.state()["trackers"].values())
        assert page.text(".hero .moving") == "", "no count of those that stow"
        for width in (320, 721, 1001, 1153, 1280):
            page.page.set_viewport_size({"width": width, "height": 740})
            assert page.page.evaluate("document.documentElement.scrollWidth") == width
            assert page.page.locator("#tracker").bounding_box()["width"] > 85, "the name of a tracker can be read"
            whole = page.page.locator(".top button:visible, .top a:not(.skip):visible, #tracker")
            assert whole.evaluate_all(f"all => all.every({IN_REACH})"), f"one lies over the other at {width}"
        assert page.complaints == []


ENDED = "Your login has ended: after 30 days without use, by a restart of the dashboard, or by a logout in another tab."


def test_a_stop_after_the_login_has_ended_is_shown_as_not_given_until_the_user_logs_in(context, site, auto):
    page = logged_in(context, site)
    context.clear_cookies()
    pressed(page, "Stop tracker, SIRTA")
    page.sees("dialog", f"{ENDED} Stop for tracker, SIRTA was NOT given. It is given once you have logged in.")
    assert page.text(".outcome p") == "Stop for tracker, SIRTA was NOT given: log in first."
    assert page.page.locator(".outcome").get_attribute("data-kind") == "bad"
    page.page.keyboard.press("Escape")
    page.sees(".outcome", "Stop for tracker, SIRTA: NOT given. Log in first.")
    page.sees("#who", "Log in")
    assert site.state()["wishes"]["stop"] is None
    pressed(page, "Stop tracker, SIRTA")
    page.sees("dialog", "Stop for tracker, SIRTA needs the service's token. It is given once you have logged in.")
    page.page.keyboard.press("Escape")
    page.sees(".outcome", "Stop for tracker, SIRTA was NOT given: it needs the token of the service at ")
    assert site.state()["wishes"]["stop"] is None
    pressed(page, "Stop tracker, SIRTA")
    page.log_in()
    page.sees(".outcome", ANSWER)
    assert site.state()["wishes"]["stop"]["by"] == "ana"
    assert page.complaints == []


def test_a_stow_after_the_login_has_ended_is_given_once_the_user_has_logged_in(context, site, auto):
    page = logged_in(context, site)
    context.clear_cookies()
    pressed(page, "Stow tracker, SIRTA")
    page.page.get_by_role("button", name="Stow now").click()
    page.sees("dialog", f"{ENDED} Stow for tracker, SIRTA was NOT given. It is given once you have logged in.")
    assert page.text(".outcome p") == "Stow for tracker, SIRTA was NOT given: log in first."
    assert site.state()["wishes"]["stow"] is None
    page.log_in()
    page.sees(".hero h1", "Stow")
    assert site.state()["wishes"]["stow"]["by"] == "ana"
    assert page.complaints == []
