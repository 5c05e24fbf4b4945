"""The view of the day in a real browser: how a day is chosen, and how reading it is given up."""

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from daemon.base.clock import iso_utc  # noqa: E402 - as below
from daemon.base.records import Event, Mode, ModeChange, Move, MoveOutcome  # noqa: E402 - as below
from daemon.service.recent import RecentRecords  # noqa: E402 - as below
from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import TRACKER, MadeSite  # noqa: E402 - as above
from tests.system.test_day_in_browser import scan  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

NOON = 1663761600.0
"""2022-09-21T12:00Z."""


def test_requests_for_a_day_are_aborted_when_the_day_view_is_left(browser, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(Event(NOON - 60.0, 0.0, "made", "an event of the day", TRACKER))
    with browser.new_context(viewport=browsers.DESKTOP) as context:
        page = site.open(context, NOON)
        page.sees(".day .log", "an event of the day")
        page.show("fleet")
        site.holds = "/read/history/events"
        with page.page.expect_request("**/read/history/events*"):
            page.show("day")
        with page.page.expect_event(
            "requestfailed", lambda request: "/history/events" in request.url, timeout=browsers.WITHIN_MS
        ):
            page.show("fleet")
        page.show("day")
        page.sees(".day .log", "an event of the day")
        assert page.complaints == []


def test_the_whole_name_of_a_day_fits_its_selector_on_a_phone(browser, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(Event(NOON - 60.0, 0.0, "made", "an event of the day", TRACKER))
    with browser.new_context(viewport=browsers.PHONE, timezone_id="UTC") as context:
        page = site.open(context, NOON)
        page.sees(".day .log", "an event of the day")
        picker, width = page.page.locator(".day select"), "select => select.offsetWidth"
        assert picker.locator("option").all_inner_texts() == ["2022-09-21 (today)"]
        shown = picker.evaluate(width)
        picker.evaluate("select => (select.style = 'width: max-content; min-width: 0')")
        assert picker.evaluate(width) <= shown


def test_a_count_of_one_is_written_in_the_singular(browser, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(scan(NOON - 60.0))
    with browser.new_context(viewport=browsers.DESKTOP) as context:
        page = site.open(context, NOON)
        page.sees(".day .summary", "1 scan; 0 moves over 0.0°.")
        said = page.page.evaluate("""async () => {
          const { equipment } = await import("/static/js/views/cards.js");
          const [card, none] = [equipment(), { lost: 0, refused: 0, waiting: 0, down_why: null }];
          const state = { bridge: { ...none, accepted: 1 }, store: { ...none, written: 1 }, trackers: {} };
          card.update({ state, tracker: null, now: 0, extra: 0 });
          return card.node.textContent;
        }""")
    assert "1 scan accepted, 0 lost" in said
    assert "1 record written, 0 wait" in said


def test_an_event_has_the_same_words_and_time_in_the_now_view_and_in_the_day_view(browser, tmp_path):
    ends = {"target_a_deg": -0.8, "target_b_deg": 81.1, "from_a_deg": 0.0, "from_b_deg": 90.0, "end_b_deg": 81.06}
    moves = [
        Move(NOON - 60.0, 0.0, 6.4, end_a_deg=-0.8, outcome=MoveOutcome.ARRIVED, why="south", tracker=TRACKER, **ends),
        Move(NOON - 50.0, 0.0, 1.6, end_a_deg=-0.04, outcome=MoveOutcome.STALLED, why="b", tracker=TRACKER, **ends),
        Move(NOON - 40.0, 0.0, 0.2, end_a_deg=12.0, outcome=MoveOutcome.ARRIVED, why="c", tracker=TRACKER, **ends),
    ]
    before, after = Mode.STARTING, Mode.TRACKING
    change = ModeChange(NOON - 61.0, 0.0, before=before, after=after, why="good", tracker=TRACKER)
    records = [change, *moves, Event(NOON - 30.0, 0.0, "made", "an event", TRACKER)]
    site, recent = MadeSite(tmp_path), RecentRecords()
    site.keep(*records)
    for record in records:
        recent.note(record)
    told = [{"time": iso_utc(news.time_utc_s), "text": news.text} for news in recent.news]
    with browser.new_context(viewport=browsers.DESKTOP, timezone_id="UTC") as context:
        page = site.open(context, NOON)
        page.sees(".day .log", "Made: an event")
        now = page.page.evaluate(
            """async (news) => {
              const { log } = await import("/static/js/views/cards.js");
              const card = log();
              card.update({ state: { news, trackers: {} }, tracker: null, now: Date.parse(news[0].time) });
              return [...card.node.querySelectorAll("li")].map((line) => line.lastChild.textContent);
            }""",
            told,
        )
        lines = page.page.locator(".day .log li")
        assert lines.locator("> span").all_inner_texts() == now
        times = lines.locator("time").evaluate_all("all => all.map((time) => time.dateTime)")
        assert times == [each["time"] for each in reversed(told)]
