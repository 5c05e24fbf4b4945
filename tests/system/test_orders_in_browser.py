"""Orders from a real browser: who gets them, what answers them, and what is said where no answer comes."""

import contextlib
import math
import socket
import time

import pytest

from tests.support.addresses import free_port
from tests.system.processes import wait_until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with browsers.simulated_site(tmp_path_factory.mktemp("site")) as found:
        yield found


@pytest.fixture
def back_to_tracking(site):
    """End whatever a test has ordered."""
    yield
    wait_until(lambda: site.order("auto").get("accepted"), site.service.log)
    site.until_mode("tracking")


@pytest.fixture
def context(browser):
    with browser.new_context(viewport=browsers.DESKTOP) as found:
        yield found


def stands_at_b_deg(site):
    pose = site.state()["tracker"]["pose"]
    return math.nan if pose is None else pose["b_deg"]


def chosen(page):
    return page.page.locator("#tracker").evaluate("picker => picker.selectedOptions[0]?.text")


def test_an_unreachable_tracker_stays_selected_and_the_orders_name_no_other_tracker(context, site, tmp_path):
    gone = f"127.0.0.1:{free_port()}"
    dashboard, url = browsers.run_dashboard(tmp_path, site.api, gone)
    try:
        page = browsers.Page(context, url, "control")
        page.sees(".hero h1", "Tracking")
        for key, label, why in (
            (f"{gone}/t7", f"t7, {gone}", f"The service at {gone} is not running"),
            (f"{site.api}/t7", f"t7, {site.api}", f"The service at {site.api} has no tracker t7 any more"),
            ("10.0.0.9:1/t7", "t7, 10.0.0.9:1", "The service at 10.0.0.9:1 is no longer one of this dashboard's"),
        ):
            page.page.evaluate("key => sessionStorage.setItem('tracker', key)", key)
            page.page.reload()
            page.sees(".hero .why", why)
            page.sees(".hero h1", "No connection")
            assert chosen(page) == label
            assert page.text(".hero .whose") == label
            assert page.page.locator("#stow").get_attribute("aria-label") == f"Stow {label}"
            assert page.page.locator("#stop").get_attribute("aria-label") == f"Stop {label}"
            playwright.expect(page.page.locator(".first :enabled, .order:enabled, .goto :enabled")).to_have_count(2)
        page.page.evaluate("key => sessionStorage.setItem('tracker', key)", site.api)
        page.page.reload()
        page.sees(".hero h1", "Tracking")
        assert page.page.locator("#tracker").input_value() == f"{site.api}/tracker"
        assert page.complaints == []
    finally:
        dashboard.stop()


def test_a_tab_keeps_its_tracker_whatever_another_tab_chooses(context, site):
    first = browsers.Page(context, site.url)
    first.sees(".hero h1", "Tracking")
    other = browsers.Page(context, site.url)
    other.sees(".hero h1", "Tracking")
    first.page.evaluate("localStorage.setItem('tracker', '127.0.0.1:1/t7')")
    for page in (first, other):
        page.page.reload()
        page.sees(".hero h1", "Tracking")
        assert page.page.locator("#tracker").input_value() == f"{site.api}/tracker"


def logged_in(context, site, view="control"):
    page = browsers.Page(context, site.url, view)
    page.sees(".hero h1", "1 tracker" if view == "fleet" else "Tracking")
    page.page.locator("#who").click()
    page.log_in()
    return page


def test_neither_a_double_click_nor_a_held_key_confirms_the_dialog_that_it_opens(context, site):
    page = logged_in(context, site)
    asked = []
    page.page.on("request", lambda request: asked.append(request.url) if request.method == "POST" else None)
    page.page.locator(".order.auto").evaluate(
        """button => {
            button.click();
            document.querySelector("dialog .go").click();
        }"""
    )
    yes = page.page.get_by_role("button", name="Auto now")
    playwright.expect(yes).to_have_count(1)
    playwright.expect(page.page.get_by_role("button", name="Cancel")).to_be_focused()
    playwright.expect(yes).to_be_enabled()
    page.page.keyboard.press("Escape")

    page.page.locator("#stow").focus()
    page.page.keyboard.down("Enter")
    yes = page.page.get_by_role("button", name="Stow now")
    playwright.expect(yes).to_be_focused()
    playwright.expect(yes).to_be_enabled()
    # While a key is held, the system sends it again without its going up.
    page.page.keyboard.down("Enter")
    page.page.keyboard.up("Enter")
    playwright.expect(yes).to_be_visible()
    page.page.keyboard.press("Escape")
    playwright.expect(yes).to_have_count(0)
    assert asked == []
    assert page.complaints == []


def test_a_long_list_of_alarms_does_not_push_an_order_off_the_screen_of_a_phone(context, site):
    page = browsers.Page(context, site.url, "control")
    page.page.set_viewport_size(browsers.PHONE)
    page.sees(".hero h1", "Tracking")
    page.page.locator(".alarms").evaluate("alarms => alarms.style.minHeight = '2000px'")
    page.page.locator(".alarms").evaluate("alarms => alarms.append('three of them')")
    auto = page.page.locator(".order.auto").bounding_box()
    assert auto["y"] + auto["height"] < page.page.locator(".first").bounding_box()["y"]


def test_a_reference_run_is_shown_under_that_name_while_it_lasts(context, site, back_to_tracking):
    page = browsers.Page(context, site.url, "control")
    page.sees(".hero h1", "Tracking")
    assert site.order("home")["accepted"]
    page.sees(".control .card .big", "Reference run: both axes move")
    page.sees(".hero h1", "Reference run")
    page.sees(".hero h1", "Tracking")


def test_while_the_service_is_gone_the_page_does_not_say_that_the_axes_stand_still(context, tmp_path):
    with browsers.simulated_site(tmp_path) as site:
        page = browsers.Page(context, site.url, "control")
        page.sees(".hero h1", "Tracking")
        site.kill()
        page.sees(".hero h1", "No connection")
        assert page.text(".control .card .big") == "Not known"
        page.show("now")
        page.sees(".hero h1", "No connection")
        assert page.text(".card .moving") == "Not known whether the axes move"


def test_with_letters_twice_as_large_no_view_is_wider_than_the_screen_of_a_phone(browser, site):
    large = browsers.launch(browser.browser_type, "--blink-settings=defaultFontSize=32")
    try:
        page = browsers.Page(large.new_context(viewport={"width": 320, "height": 640}), site.url)
        for view, shown in [
            ("now", ".equipment td"),
            ("control", ".order.auto"),
            ("fleet", ".fleet td"),
            ("day", ".day select"),
        ]:
            page.show(view)
            page.page.wait_for_selector(shown)
            assert page.page.evaluate("document.documentElement.scrollWidth") == 320, view
        page.page.locator("#who").click()
        assert page.page.get_by_role("dialog").evaluate("dialog => dialog.scrollWidth - dialog.clientWidth") == 0
        assert page.complaints == []
    finally:
        large.close()


def test_a_long_reason_does_not_make_the_page_wider_than_the_screen_of_a_phone(context, site):
    page = browsers.Page(context, site.url, "control")
    page.page.set_viewport_size({"width": 320, "height": 640})
    page.sees(".hero h1", "Tracking")
    width = page.page.evaluate(
        """() => {
            document.querySelector(".hero .why").textContent = "/var/lib/heliocube/tracker/learned.json cannot be read";
            return document.documentElement.scrollWidth;
        }"""
    )
    assert width == 320


def test_stow_for_all_asks_for_the_token_again_when_the_session_is_gone(context, site, back_to_tracking):
    page = logged_in(context, site, "fleet")
    context.clear_cookies()
    page.page.get_by_role("button", name="Stow all").click()
    page.page.get_by_role("button", name="Stow now").click()
    page.sees("dialog", "Your login has ended")
    page.sees("dialog", "Stow for all was NOT given.")
    page.log_in()
    page.sees(".outcome", "Stow was taken by the service.")
    assert site.state()["wishes"]["stow"]["by"] == "ana"
    assert page.complaints == []


def test_stow_for_all_asks_for_the_token_again_if_that_of_a_service_has_changed(context, site, back_to_tracking):
    page = logged_in(context, site, "fleet")
    refusal = {"service": site.api, "accepted": False, "status": 401, "text": "the token is not the service's"}
    page.page.route("**/stow-all", lambda route: route.fulfill(json={"results": [refusal]}), times=1)
    page.page.get_by_role("button", name="Stow all").click()
    page.page.get_by_role("button", name="Stow now").click()
    page.sees("dialog", "The token is not the service's.")
    page.sees(".outcome", "Stow was NOT taken by 1 of 1 services")
    page.sees("#who", "ana")
    page.log_in()
    page.sees(".outcome", "Stow was taken by the service.")
    assert page.complaints == []


def test_a_late_session_answer_from_before_the_login_does_not_log_the_user_out(context, site):
    held = []
    context.route("**/session", lambda route: held.append(route), times=1)
    page = logged_in(context, site)
    page.sees("#who", "ana")
    held[0].fulfill(json={"by": None, "services": []})
    page.page.evaluate("fetch('/session').then((answer) => answer.text())")
    page.page.wait_for_timeout(200)
    assert page.text("#who") == "ana"
    assert page.complaints == []


def test_stow_for_all_counts_a_service_that_does_not_answer(context, site, tmp_path, back_to_tracking):
    gone = f"127.0.0.1:{free_port()}"
    dashboard, url = browsers.run_dashboard(tmp_path, site.api, gone)
    try:
        page = browsers.Page(context, url, "fleet")
        page.sees(".hero h1", "1 tracker: 1 needs attention")
        page.sees(".hero .why", "1 tracking, 1 service does not answer")
        page.page.get_by_role("button", name="Stow all").click()
        page.log_in()
        page.page.get_by_role("button", name="Stow now").click()
        page.sees(".outcome", "Stow was NOT taken by 1 of 2 services: see the list")
        page.sees(".results .problem", f"{gone}: NOT DONE: the service does not answer")
        page.sees(".hero .moving", "1 of 1 stand stowed, 1 service does not answer, ")
        assert page.complaints == []
    finally:
        dashboard.stop()


def test_a_logout_or_an_order_without_an_answer_of_the_dashboard_is_not_shown_as_done(context, site):
    page = logged_in(context, site)
    page.page.route("**/logout", lambda route: route.abort())
    page.page.locator("#who").click()
    page.sees(".outcome", "Not logged out: The dashboard does not answer.")
    page.sees("#who", "ana")
    page.page.route("**/command", lambda route: route.abort())
    page.page.locator(".order.hold").click()
    page.sees(
        ".outcome",
        "Hold for tracker, SIRTA: The dashboard does not answer. The order may not have arrived: look at the tracker.",
    )
    assert page.complaints == []


def test_an_order_without_an_answer_is_shown_as_unanswered_and_given_up_in_the_end(context, site):
    context.clock.install()
    page = logged_in(context, site)
    page.page.route("**/command", lambda _: None)
    page.page.locator(".order.stop").click()
    page.sees(".outcome", "Stop: sent to tracker, SIRTA ...")
    page.page.clock.fast_forward(10_000)
    page.sees(".outcome", "Stop: sent to tracker, SIRTA, and no answer yet: look at the tracker.")
    page.page.clock.fast_forward(30_000)
    page.sees(
        ".outcome",
        "Stop for tracker, SIRTA: The dashboard does not answer. The order may not have arrived: look at the tracker.",
    )
    assert page.complaints == []


def test_an_order_carries_the_time_when_it_was_given_by_the_clock_of_the_dashboard(context, site, back_to_tracking):
    page = logged_in(context, site)
    given_s = []

    def note(route):
        given_s.append(route.request.post_data_json["given_s"])
        route.continue_()

    page.page.route("**/command", note)
    page.page.locator(".order.hold").click()
    page.sees(".outcome", "Hold for tracker, SIRTA: standing")
    # Dashboard and test have the clock of one machine.
    assert given_s == [pytest.approx(time.monotonic(), abs=30.0)]
    assert page.complaints == []


def press_late(context, page, button):
    """Press a button a minute before the page hears of it."""
    # The browser dates no press before the page's own beginning: let the page grow old first.
    page.page.evaluate("new Promise((go) => setTimeout(go, 11000 - performance.now()))")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    place = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "button": "left", "clickCount": 1}
    late = context.new_cdp_session(page.page)
    for kind in ("mousePressed", "mouseReleased"):
        late.send("Input.dispatchMouseEvent", {"type": kind, "timestamp": time.time() - 60.0, **place})


def test_an_order_pressed_while_the_page_was_frozen_is_not_sent_when_it_goes_on(context, site):
    page = logged_in(context, site)
    asked = []
    page.page.on("request", lambda request: asked.append(request.url) if request.method == "POST" else None)
    press_late(context, page, page.page.locator(".order.hold"))
    page.sees(".outcome", "s: what was pressed meanwhile is not done.")
    assert asked == []
    assert page.complaints == []


@pytest.mark.parametrize("button", ["#stop", ".order.stop"])
def test_a_stop_pressed_while_the_page_was_frozen_is_sent_when_it_goes_on(context, site, back_to_tracking, button):
    page = logged_in(context, site)
    press_late(context, page, page.page.locator(button))
    page.sees(".outcome", "mode hold: stopped by ana")
    assert page.complaints == []


@contextlib.contextmanager
def hung_service():
    """Give the address of a server that takes every connection and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listens:
        yield f"127.0.0.1:{listens.getsockname()[1]}"


# What the day view reads of a service that has just begun to hang.
READ_ALL = """
async (address) => {
    const { numbers } = await import("/static/js/history.js");
    for (let n = 0; n < 12; n += 1) numbers(address, "scans", n, 1000).catch(() => {});
}
"""
READ_DAYS = 'async (address) => (await import("/static/js/history.js")).storedDays(address)'


def test_an_order_does_not_wait_for_readings_requested_from_another_service_that_hangs(
    context, site, back_to_tracking, tmp_path
):
    with hung_service() as hung:
        dashboard, url = browsers.run_dashboard(tmp_path, site.api, hung)
        try:
            page = browsers.Page(context, url, "control")
            page.sees(".hero h1", "Tracking")
            page.page.locator("#who").click()
            page.log_in()
            page.page.evaluate(READ_ALL, hung)
            page.page.locator(".order.hold").click()
            # The dashboard gives up a silent service only after 30 s; the order must not wait for that.
            playwright.expect(page.page.locator(".outcome")).to_contain_text(
                "Hold for tracker, SIRTA: standing", timeout=25_000
            )
            assert page.page.evaluate(READ_DAYS, site.api) == ["2022-09-21"]
            assert page.complaints == []
        finally:
            dashboard.stop()


def test_a_tracker_whose_stow_fails_is_not_counted_as_stowed_between_two_attempts(browser, tmp_path):
    with browsers.site_on_bench(tmp_path) as (site, bench), browser.new_context() as context:
        page = browsers.Page(context, site.url, "fleet")
        # At the start the tracker stands stowed, which would pass for this stow.
        wait_until(lambda: stands_at_b_deg(site) < 85.0, site.service.log)
        bench.ask("inject", "b_ignores_targets")
        page.page.get_by_role("button", name="Stow all").click()
        page.log_in()
        page.page.get_by_role("button", name="Stow now").click()
        page.sees(".fleet [data-name=Alarms]", "move-failed")
        state = site.state()
        assert (state["mode"]["name"], state["tracker"]["moving"]) == ("stow", False)
        page.sees(".hero .moving", "0 of 1 stand stowed, ")
        bench.ask("repair", "b_ignores_targets")
