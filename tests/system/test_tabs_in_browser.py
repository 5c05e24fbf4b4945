"""Tabs of a real browser: what they say when they are behind others, were hidden, or slept with their machine."""

import contextlib
import shutil
import subprocess
import sys

import pytest

from daemon.dashboard.app import STATIC
from tests.support import PATIENCE_S
from tests.support.addresses import free_port
from tests.system.processes import wait_until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

HIDE = """(state) => {
    Object.defineProperty(document, "visibilityState", { value: state, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
}"""
"""Does what a browser does with a tab behind another one: playwright keeps all tabs in front."""
OF_FILES = """
import sys
from pathlib import Path
from daemon.dashboard import app
app.STATIC = Path(sys.argv.pop(1))
from daemon.entry import main
main()
"""
"""The program with a dashboard that serves the files of another folder."""


@pytest.fixture(scope="module")
def the_site(tmp_path_factory):
    with browsers.simulated_site(tmp_path_factory.mktemp("site")) as found:
        yield found


@pytest.fixture
def site(the_site):
    """The site, tracking."""
    if the_site.mode() != "tracking":
        wait_until(lambda: the_site.order("auto").get("accepted"), the_site.service.log)
    the_site.until_mode("tracking")
    return the_site


@pytest.fixture
def context(browser):
    with browser.new_context(viewport=browsers.DESKTOP) as found:
        yield found


def listeners(site):
    """Return how many streams the dashboard sends."""
    return browsers.WEB.get(f"{site.url}/healthz").json()["listeners"]


def test_seven_tabs_of_one_browser_are_all_live_over_one_stream(context, site):
    first = browsers.Page(context, site.url)
    # A browser holds six connections to a host.
    tabs = [first, *(browsers.Page(context, site.url) for _ in range(6))]
    for tab in tabs:
        tab.sees(".hero h1", "Tracking")
    before = [tab.text("#clock") for tab in tabs]
    wait_until(lambda: all(tab.text("#clock") != old for tab, old in zip(tabs, before, strict=True)), "all go on")
    # The stream of a page that another test has closed may end late.
    wait_until(lambda: listeners(site) in (1, 2), "one stream for seven tabs")


def test_a_login_or_logout_in_one_tab_takes_effect_in_the_others(context, site):
    first, other = browsers.Page(context, site.url, "control"), browsers.Page(context, site.url)
    first.sees(".hero h1", "Tracking")
    other.page.locator("#who").click()
    other.log_in()
    first.sees("#who", "ana")
    first.page.locator("#stop").click()
    first.sees(".outcome", "mode hold: stopped by ana")
    other.page.locator("#who").click()
    first.sees("#who", "Log in")
    assert first.complaints == other.complaints == []


def test_values_from_before_the_computer_slept_are_shown_as_old_when_it_wakes(context, site):
    page = browsers.Page(context, site.url)
    page.sees(".hero h1", "Tracking")
    # A browser has two clocks. The one that counts from its start stands still while the machine sleeps.
    seen = page.page.evaluate(
        """() => {
            const now = Date.now;
            Date.now = () => now() + 3600e3;
            document.dispatchEvent(new Event("visibilitychange"));
            Date.now = now;
            return document.querySelector(".hero h1").textContent;
        }"""
    )
    assert seen == "No connection: what is shown is old"
    page.sees(".hero h1", "Tracking")


def test_a_new_tab_does_not_show_the_old_state_that_a_hidden_tab_received(context, site):
    older = browsers.Page(context, site.url)
    older.sees(".hero h1", "Tracking")
    before = listeners(site)
    older.page.evaluate(HIDE, "hidden")
    wait_until(lambda: listeners(site) < before, "no stream for a hidden tab")
    site.order("stop")
    with context.browser.new_context() as elsewhere:
        # The dashboard hears of the stop a moment after the service.
        browsers.Page(elsewhere, site.url).sees(".hero h1", "Stopped by a person")
    context.add_init_script(
        """window.seen = new Set();
        const look = () => window.seen.add(document.querySelector(".hero h1")?.textContent);
        new MutationObserver(look).observe(document, { subtree: true, childList: true, characterData: true });"""
    )
    newer = browsers.Page(context, site.url)
    newer.sees(".hero h1", "Stopped by a person")
    assert "Tracking" not in newer.page.evaluate("[...window.seen]")


def test_a_tab_behind_another_one_has_the_state_in_its_title(context, site):
    behind = browsers.Page(context, site.url)
    behind.sees(".hero h1", "Tracking")
    browsers.Page(context, site.url).sees(".hero h1", "Tracking")
    behind.page.evaluate(HIDE, "hidden")
    site.order("stop")
    playwright.expect(behind.page).to_have_title("stopped, tracker, SIRTA", timeout=browsers.WITHIN_MS)
    assert behind.text(".hero h1") == "Tracking"


def test_the_loss_of_the_dashboard_is_shown_with_its_time_by_the_clock_of_the_service(context, tmp_path):
    # The reader's clock is two months late, and the simulated day is years ago.
    context.add_init_script("const now = Date.now.bind(Date); Date.now = () => now() - 5e9")
    with browsers.simulated_site(tmp_path) as site:
        page = browsers.Page(context, site.url)
        page.sees(".hero h1", "Tracking")
        clock = page.text("#clock").split()[0]
        site.dashboard.stop()
        page.sees("#banner", "No connection to the dashboard since ")
        told = page.text("#banner").split("since ")[1].split(".")[0]
    since, shown = (
        sum(int(part) * 60**power for power, part in enumerate(reversed(time.split(":")))) for time in (told, clock)
    )
    assert 0 <= since - shown < 120


def test_the_symbols_of_the_page_are_still_drawn_when_the_dashboard_is_gone(context, tmp_path):
    dashboard, url = browsers.run_dashboard(tmp_path, f"127.0.0.1:{free_port()}")
    page = browsers.Page(context, url)
    page.sees(".hero h1", "No connection")
    dashboard.stop()
    page.sees("#banner", "No connection to the dashboard")
    page.page.get_by_role("link", name="Control").click()
    page.sees(".order.stop", "Stop")
    drawn = page.page.locator("svg > use").evaluate_all("all => all.map((each) => each.getBBox().width > 5)")
    assert len(drawn) > 12
    assert all(drawn)
    assert page.complaints == []


@contextlib.contextmanager
def dashboard_of(files, site, listen):
    arguments = ["dashboard", "--api", site.api, "--listen", listen]
    process = subprocess.Popen([sys.executable, "-c", OF_FILES, files, *arguments], stderr=subprocess.DEVNULL)
    try:
        yield f"http://{listen}"
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def test_after_an_upgrade_of_the_dashboard_open_pages_do_not_depend_on_the_older_code(context, site, tmp_path):
    older = tmp_path / "older"
    shutil.copytree(STATIC, older)
    for name, now, before in (
        ("worker.js", "port.postMessage(message)", "port.postMessage({ older: message })"),
        ("live.js", "this.take(data)", "this.take(data.older)"),
    ):
        file = older / "js" / name
        text = file.read_text()
        assert now in text
        file.write_text(text.replace(now, before))
    listen = f"127.0.0.1:{free_port()}"
    with dashboard_of(older, site, listen) as url:
        wait_until(lambda: browsers.answers(url), "the older dashboard answers")
        one, other = (browsers.Page(context, url) for _ in range(2))
        for page in (one, other):
            page.sees(".hero h1", "Tracking")
        # This page stays as it is while somebody types in it.
        other.page.locator("#who").click()
    with dashboard_of(STATIC, site, listen):
        one.sees(".hero h1", "No connection")
        one.sees(".hero h1", "Tracking")
        other.page.keyboard.press("Escape")
        other.sees(".hero h1", "Tracking")
        assert one.complaints == other.complaints == []
