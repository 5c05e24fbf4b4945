"""The dashboard as people have it: a real browser, a service on the bench, orders that move its axes."""

import json
import re
import struct
from datetime import datetime
from urllib.parse import parse_qs, urlsplit

import pytest

from tests.support.addresses import free_port
from tests.system.processes import wait_until

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]


# 21 September 2022, counted from 1970.
RECEIVED = {
    "day": 19256,
    "since_utc_s": 1663757000.0,
    "known_s": 3600.0,
    "actual_kwh_m2": 0.9,
    "chronometric_kwh_m2": 0.8,
    "best_kwh_m2": 0.95,
}


@pytest.fixture(scope="module")
def the_site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    # An hour of light is counted already, so that the page has something to show from the start.
    (folder / "records").mkdir()
    (folder / "records" / "received.json").write_text(json.dumps(RECEIVED))
    with browsers.simulated_site(folder) as site:
        yield site


@pytest.fixture
def site(the_site):
    """The site, tracking; whatever a test did to it ends with the test."""
    the_site.until_mode("tracking")
    yield the_site
    if the_site.mode() != "tracking":
        wait_until(lambda: the_site.order("auto").get("accepted"), the_site.service.log)


@pytest.fixture
def open_page(browser, site):
    """Open a page of the dashboard: ``open_page(view, viewport)``; it may complain of nothing."""
    contexts, pages = [], []

    def open_one(view="now", viewport=browsers.DESKTOP, context=None, **options):
        if context is None:
            context = browser.new_context(viewport=viewport, timezone_id="Europe/Paris", **options)
            contexts.append(context)
        pages.append(browsers.Page(context, site.url, view))
        return pages[-1]

    yield open_one
    complaints = [page.complaints for page in pages if page.complaints]
    outside = {asked for page in pages for asked in page.asked if not asked.startswith(site.url)}
    for context in contexts:
        context.close()
    assert complaints == []
    assert outside == set()


def figure(text):
    return float(re.search(r"[−+\-]?\d+(?:\.\d+)?", text)[0].replace("−", "-"))


def test_stow_is_the_biggest_button_of_a_phone_and_two_touches_away_and_moves_the_axes(site, open_page):
    page = open_page("now", browsers.PHONE, has_touch=True, is_mobile=True)
    page.sees(".hero h1", "Tracking")
    stow = page.page.locator("#stow")
    boxes = {}
    for button in page.page.locator("button:visible, a:visible").all():
        box = button.bounding_box()
        boxes[button.inner_text()] = box["width"] * box["height"]
    assert max(boxes, key=boxes.get) == "Stow"
    box = stow.bounding_box()
    assert box["y"] + box["height"] <= browsers.PHONE["height"], "it is seen without scrolling"

    page.page.locator("#who").tap()
    page.log_in()
    page.sees("#who", "ana")
    stow.tap()
    page.page.get_by_role("button", name="Stow now").tap()
    page.sees(".hero h1", "Stow")
    page.sees(".outcome", "Stow for tracker, SIRTA: ")
    page.sees(".wish", "by ana")
    page.sees(".gauge:nth-child(2) .value", "90.0°")
    page.sees(".moving", "Standing still")
    assert site.state()["tracker"]["pose"]["b_deg"] == pytest.approx(90, abs=0.1)
    assert site.state()["wishes"]["stow"]["by"] == "ana"
    assert browsers.TOKEN not in page.page.content()
    assert browsers.TOKEN not in json.dumps(page.page.evaluate("({...localStorage, cookie: document.cookie})"))

    page.show("control")
    page.page.get_by_role("button", name="Auto", exact=True).tap()
    page.page.get_by_role("button", name="Auto now").tap()
    page.sees(".hero h1", "Tracking")


def test_goto_accepts_only_angles_within_the_limits_and_shows_who_holds_the_tracker(site, open_page):
    page = open_page("control")
    page.page.get_by_label("A, east negative").fill("-6")
    page.page.get_by_label("B, flat is 90").fill("95")
    page.page.get_by_role("button", name="Go there and hold").click()
    assert page.page.evaluate("document.querySelector('[name=b_deg]').validity.rangeOverflow")
    page.page.get_by_label("B, flat is 90").fill("84")
    page.page.get_by_role("button", name="Go there and hold").click()
    page.log_in()
    page.sees(".outcome", "Goto for tracker, SIRTA: ")
    page.sees(".wish", "Held by ana")
    page.sees(".control .big", "Both axes stand still")
    wait_until(lambda: abs(site.state()["tracker"]["pose"]["a_deg"] + 6) < 0.5, "the tracker there")
    page.sees(".control .card .hint", "A −6.")


def test_on_the_bench_stow_moves_the_axes_and_the_page_shows_outages_and_their_end(browser, tmp_path):
    with browsers.site_on_bench(tmp_path) as (site, bench), browser.new_context() as context:
        page = browsers.Page(context, site.url)
        page.sees(".hero h1", "Tracking")
        page.sees(".simulated", "SIMULATED")
        page.page.locator("#stow").click()
        page.log_in()
        page.page.get_by_role("button", name="Stow now").click()
        page.sees(".hero h1", "Stow")
        wait_until(lambda: bench.state()["pose"]["b_deg"] > 89.5, "the bench's tracker in its stow position")
        page.sees(".gauge:nth-child(2) .value", re.compile(r"(89\.9|90\.0)°"))
        bench.ask("unplug", "positioner")
        page.sees(".hero h1", "Fault")
        page.sees(".card[aria-label=Equipment] tbody", "down")
        page.sees(".card[aria-label=Tracker].stale .age", "STALE")
        page.sees(".card .moving", "Not known whether the axes move")
        assert page.page.locator(".hero").get_attribute("data-kind") == "bad"

        site.kill()
        page.sees(".hero h1", "No connection: what is shown is old")
        page.sees(".hero .why", site.api)
        bench.ask("replug", "positioner")
        site.start()
        page.sees(".hero h1", "Stow")
        assert page.complaints == []


def test_a_day_is_drawn_from_the_store_with_modes_moves_and_events(site, open_page):
    page = open_page("day")
    page.sees(".day .log", "Starting -> tracking: the cube's readings are good")
    page.sees(".day .summary", "Tracking ")
    pictures = page.page.locator(".plot .canvas")
    said = [picture.get_attribute("aria-label") for picture in pictures.all()]
    assert re.match(r"Irradiance W/m²: east from \d+ to \d+; south", said[0])
    assert any(re.match(r"Angle A, east negative degrees: the sun's from −\d+.* actual from", text) for text in said)
    wind = next(text for text in said if text.startswith("Wind, strongest since the reading before m/s: wind from "))
    assert wind.endswith("; stows from (as set now) from 15.0 to 15.0")
    assert len(said) == 5
    stored = browsers.WEB.get(f"http://{site.api}/api/days").json()["days"]
    assert page.page.get_by_label("Day", exact=True).input_value() == stored[-1] == "2022-09-21"
    page.page.get_by_role("button", name="Last hour").click()
    page.sees(".day .hint", "Shown: 12:5")
    page.page.get_by_role("button", name="Whole day").click()
    page.sees(".day .hint", "Shown: the whole solar day, 02:00:00")


def test_the_day_view_shows_the_day_requested_last_and_says_which_records_end_early(open_page):
    page = open_page("now")
    days = [f"2022-09-{number}" for number in (17, 18, 19, 20, 21)]

    def modes(route):
        begin = parse_qs(urlsplit(route.request.url).query)["from"][0]
        row = {"time": begin, "before": "starting", "after": "stow", "why": f"the begin of {begin[:10]}"}
        route.fulfill(json={"rows": [row], "more": begin.startswith("2022-09-18")})

    page.page.route("**/read/days?*", lambda route: route.fulfill(json={"days": days}))
    page.page.route("**/read/history/modes?*", modes)
    page.show("day")
    page.sees(".day .log", "the begin of 2022-09-21")
    assert "end early" not in page.text(".day .summary")
    page.page.get_by_role("button", name="Day before").evaluate("button => [1, 2, 3].forEach(() => button.click())")
    page.sees(".day .log", "the begin of 2022-09-18")
    assert page.page.get_by_label("Day", exact=True).input_value() == "2022-09-18"
    page.sees(".day .summary", "more records than fit here: modes end early.")


def test_the_day_view_does_not_request_records_again_that_it_has(open_page):
    page = open_page("now")
    # In 32 bits this would be 70000.0 s after the beginning.
    last_s = 70000.0035
    head = {"rows": 1, "columns": ["time_s", *(f"{face}_w_m2" for face in ("east", "south", "west", "zenith"))]}
    begun, later = [], []

    def scans(route):
        begin_s = datetime.fromisoformat(parse_qs(urlsplit(route.request.url).query)["from"][0]).timestamp()
        (later if begun else begun).append(begin_s)
        found = json.dumps(head | {"start": begin_s, "more": False}).encode() + b"\n"
        route.fulfill(body=found + struct.pack("<5f", last_s, 1.0, 2.0, 3.0, 4.0))

    page.page.route("**/read/history/scans?*", scans)
    page.show("day")
    page.sees(".day .log", "Starting -> tracking")
    page.page.evaluate("const now = performance.now.bind(performance); performance.now = () => now() + 60000")
    with page.page.expect_response("**/read/history/scans?*", timeout=browsers.WITHIN_MS):
        pass
    assert begun[0] + last_s < later[0] < begun[0] + last_s + 0.01


def test_ten_trackers_are_seen_at_once_and_stowed_by_one_button(browser, tmp_path):
    with browsers.fleet_site(tmp_path) as site, browser.new_context(viewport=browsers.DESKTOP) as context:
        page = browsers.Page(context, site.url, "fleet")
        page.sees(".hero h1", "10 trackers: none needs attention")
        assert page.page.locator(".fleet tbody tr").count() == 10
        page.page.get_by_role("button", name="Stow all").click()
        page.log_in()
        page.page.get_by_role("button", name="Stow now").click()
        page.sees(".outcome", "Stow was taken by the service.")
        page.sees(".hero .why", "10 stow")
        page.sees(".hero .moving", "All 10 stand stowed.")
        modes = [tracker["mode"]["name"] for tracker in site.state()["trackers"].values()]
        assert modes == ["stow"] * 10
        page.page.get_by_role("link", name="t7, SIRTA").click()
        page.sees(".hero h1", "Stow")
        assert page.page.locator("#tracker").input_value().endswith("/t7")
        assert page.text(".hero .whose") == "t7, SIRTA"
        assert page.complaints == []


def test_a_long_name_leaves_the_mode_of_a_tracker_in_sight(open_page):
    page = open_page("fleet", browsers.TABLET)
    page.sees(".fleet td", "tracking")
    link = page.page.locator(".fleet th a")
    link.evaluate("link => link.textContent = 'at the long field behind the barn '.repeat(4)")
    mode = page.page.locator(".fleet td").first.bounding_box()
    assert mode["x"] + mode["width"] < browsers.TABLET["width"]


@pytest.fixture(scope="module")
def any_page(browser, the_site):
    """Give a page that takes every size and every scheme of colours, one after the other."""
    with browser.new_context(timezone_id="Europe/Paris", bypass_csp=True) as context:
        yield browsers.Page(context, the_site.url)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("viewport", [browsers.PHONE, browsers.DESKTOP], ids=["phone", "desktop"])
def test_every_view_of_the_dashboard_passes_the_accessibility_checks(site, any_page, viewport, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    page = any_page
    page.page.set_viewport_size(viewport)
    page.page.emulate_media(color_scheme=scheme)
    for view, selector, text in [
        ("now", ".hero h1", "Tracking"),
        ("control", ".hero h1", "Tracking"),
        ("fleet", ".hero h1", "1 tracker"),
        ("day", ".day .summary", "scans"),
    ]:
        page.show(view)
        page.sees(selector, text)
        found = axe.Axe().run(page.page).response["violations"]
        assert [(each["id"], [node["target"] for node in each["nodes"]]) for each in found] == []
    page.page.locator("#stow").click()
    found = axe.Axe().run(page.page).response["violations"]
    assert [(each["id"], [node["target"] for node in each["nodes"]]) for each in found] == []
    page.page.keyboard.press("Escape")
    assert page.complaints == []


def test_views_orders_and_login_can_be_reached_with_the_keyboard_alone(site, open_page):
    page = open_page()
    page.sees(".hero h1", "Tracking")
    reached = []
    for _ in range(10):
        page.page.keyboard.press("Tab")
        reached.append(page.page.evaluate("document.activeElement.innerText || document.activeElement.ariaLabel"))
    assert reached[0] == "Skip to the content"
    assert {"Now", "Day", "Fleet", "Control", "Log in", "Stop", "Stow"} <= {text.strip() for text in reached}
    page.page.locator("#stow").focus()
    page.page.keyboard.press("Enter")
    dialog = page.page.get_by_role("dialog")
    playwright.expect(dialog).to_be_visible()
    page.page.keyboard.press("Escape")
    playwright.expect(dialog).to_have_count(0)


def test_a_screen_reader_announces_a_change_of_mode_and_alarms_but_not_the_passing_seconds(site, open_page):
    page = open_page("control")
    page.sees(".hero h1", "Tracking")
    # What a screen reader says of its own accord, as it changes.
    page.page.evaluate(
        """() => {
            window.told = [];
            const live = (node) => node.parentElement?.closest("[role=status], [role=alert], [aria-live]");
            const tell = ({ target }) => live(target) && told.push(target.textContent);
            new MutationObserver((found) => found.forEach(tell))
                .observe(document.querySelector("main"), { subtree: true, childList: true, characterData: true });
        }"""
    )
    site.order("stop")
    page.sees(".hero h1", "Stopped by a person")
    playwright.expect(page.page.locator(".hero .since")).not_to_have_text(page.text(".hero .since"))
    told = page.page.evaluate("told")
    assert "Stopped by a person" in told
    assert not any(text.startswith("since ") for text in told)
    assert page.page.locator(".alarms").get_attribute("aria-live") == "polite"


def test_the_skip_link_moves_the_focus_to_the_content_and_keeps_the_view_that_is_shown(open_page):
    page = open_page("constructor")
    page.sees(".hero h1", "Tracking")
    page.show("control")
    page.sees(".hero h1", "Tracking")
    page.page.locator(".skip").focus()
    page.page.keyboard.press("Enter")
    playwright.expect(page.page.locator("#view")).to_be_focused()
    assert page.page.locator(".goto").count() == 1


def test_the_figures_on_the_page_agree_with_those_of_the_api(site, open_page):
    page = open_page()
    page.sees(".hero h1", "Tracking")

    def shown():
        cells = page.page.locator(".card[aria-label=Cube] tbody tr").all_inner_texts()
        wind = page.text(".card[aria-label=Wind] .big")
        equipment = page.text(".card[aria-label=Equipment] tbody")
        return {
            "a": figure(page.text(".gauge:nth-child(1) .value")),
            "b": figure(page.text(".gauge:nth-child(2) .value")),
            "faces": [figure(cell.partition("\t")[2]) for cell in cells],
            "wind": figure(wind),
            "moves": page.text(".facts div:has-text('Moves today') dd"),
            "sun": figure(page.text(".facts div:has-text('Sun') dd").partition("elevation")[2]),
            "board": site_board in equipment,
            "gain": figure(page.text(".facts div:has-text('Against chronometric') dd")),
            "next_b": figure(page.text(".facts div:has-text('In the present light') dd").partition("B ")[2]),
        }

    site_board = site.state()["tracker"]["identity"]["board"]

    def said():
        state = site.state()
        pose, faces = state["tracker"]["pose"], state["scan"]["faces"]
        return {
            "a": round(pose["a_deg"], 1),
            "b": round(pose["b_deg"], 1),
            "faces": [float(round(faces[name]["irradiance_w_m2"])) for name in ("east", "south", "west", "zenith")],
            "wind": round(state["wind"][0]["speed_m_s"], 1),
            # With a comma, "1, 299 left" was read as a thousand.
            "moves": f"{state['today']['moves']} ({state['today']['left']['moves']} left)",
            "sun": round(state["sun_elevation_deg"], 1),
            "board": True,
            "gain": round(100 * state["received"]["gain"], 1),
            "next_b": round(state["next_decision"]["target_b_deg"], 1),
        }

    pairs = []

    def agree():
        # The readings go on changing: all of them have to agree at one moment.
        pairs.append((said(), shown()))
        return close(*pairs[-1])

    wait_until(agree, lambda: f"the same figures: {pairs[-1]}")
    assert page.text(".simulated").startswith("SIMULATED")


def close(said, shown):
    faces = all(abs(one - other) <= 1 for one, other in zip(said["faces"], shown["faces"], strict=True))
    rest = (said[name] == pytest.approx(shown[name], abs=0.101) for name in said if name != "faces")
    return faces and all(rest)


def test_every_view_shows_that_the_service_does_not_answer(browser, tmp_path):
    dashboard, url = browsers.run_dashboard(tmp_path, f"127.0.0.1:{free_port()}")
    try:
        with browser.new_context(viewport=browsers.PHONE) as context:
            page = browsers.Page(context, url)
            page.sees(".hero h1", "No connection")
            for view, selector, words in (
                ("day", ".day", "No stored day to show"),
                ("fleet", ".hero h1", "The service does not answer"),
                ("fleet", ".fleet [data-name=Alarms]", "–"),
                ("control", ".control", "Not known"),
            ):
                page.show(view)
                page.sees(selector, words)
            assert page.complaints == []
    finally:
        dashboard.stop()
