"""The times that the page tells, in a real browser: those of the service, in the reader's time zone."""

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import MadeSite  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

FIRM = "\xa0"
"""A blank at which no line breaks: between a number and its unit."""

MIDNIGHT = 1663718400.0
"""2022-09-21T00:00Z."""


@pytest.fixture
def context(browser):
    with browser.new_context(viewport=browsers.DESKTOP, timezone_id="UTC") as found:
        yield found


def test_a_local_time_has_the_local_date(browser, tmp_path):
    with browser.new_context(timezone_id="Australia/Sydney") as context:
        page = MadeSite(tmp_path).open(context, MIDNIGHT)
        said = page.page.evaluate("""async () => {
          const { at } = await import("/static/js/format.js");
          const { log } = await import("/static/js/views/cards.js");
          const [now, times] = [Date.parse("2022-09-21T00:10:00Z"), ["2022-09-20T13:00:00Z", "2022-09-20T23:50:00Z"]];
          const card = log();
          const state = { trackers: {}, news: times.map((time) => ({ time, text: "x" })) };
          card.update({ state, tracker: null, now });
          const listed = [...card.node.querySelectorAll("time")].map((each) => each.textContent);
          return [times.map((time) => at(time, now)), listed];
        }""")
    assert said == [
        [f"2022-09-20 23:00{FIRM}local (13:00{FIRM}UTC)", f"09:50{FIRM}local (23:50{FIRM}UTC)"],
        ["09:50 23:50 UTC", "2022-09-20 23:00 13:00 UTC"],
    ]


def test_the_beginning_of_what_lasts_over_midnight_is_shown_with_its_date_from_then_on(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { hero } = await import("/static/js/views/hero.js");
      const card = hero(null);
      const since = "2022-09-21T23:10:00Z";
      const alarm = { name: "reference", severity: "warning", state: "raised", tracker: null, text: "x", since };
      const tracker = { mode: { name: "hold", since, why: "x" }, wishes: { hold: { since, why: "x" } } };
      return ["2022-09-21T23:59:59Z", "2022-09-22T00:00:00Z"].map((now) => {
        const context = { state: { alarms: [alarm] }, entry: { key: "made" }, tracker, now: Date.parse(now) };
        card.update({ ...context, tracker: { ...tracker, tracker: { name: "roof" } } });
        return [...card.node.querySelectorAll(".since, .alarm .hint, .wish p")].map((each) => each.textContent);
      });
    }""")
    for before, after in zip(*said, strict=True):
        assert f"since 23:10{FIRM}local" in before
        assert f"since 2022-09-21 23:10{FIRM}local" in after


def test_a_stop_from_the_day_before_is_shown_with_its_own_beginning_after_a_restart_too(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { hero } = await import("/static/js/views/hero.js");
      const card = hero(null);
      const wishes = { stop: { since: "2022-09-20T18:12:00Z", why: "x" } };
      const mode = { name: "hold", asked: "stop", since: "2022-09-21T05:00:00Z", why: "x" };
      const tracker = { mode, wishes, tracker: { name: "roof" } };
      card.update({ state: { alarms: [] }, entry: { key: "made" }, tracker, now: Date.parse("2022-09-21T06:12:00Z") });
      return card.node.querySelector(".since").textContent;
    }""")
    assert said.startswith("since 2022-09-20 ")
    assert said.endswith(f", for 12{FIRM}h 0{FIRM}min")


def test_the_light_of_a_decision_is_shown_only_while_the_law_decides(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { light } = await import("/static/js/views/cards.js");
      const card = light();
      const decision = { dni_est: 3, dhi_est: 12, albedo_est: 0.2 };
      return [45, null, 60].map((next_decision_s) => {
        card.update({ tracker: { decision, next_decision_s, law: {}, load: null }, extra: 0, old: false });
        return card.node.hidden;
      });
    }""")
    assert said == [False, True, False]


def test_a_wind_stow_shows_the_time_until_its_release_or_the_reason_why_none_is_known(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { wind } = await import("/static/js/views/cards.js");
      const card = wind();
      const speeds = { speed_m_s: 3, stow_from_m_s: 15, release_below_m_s: 10, age_s: 1 };
      return [["wind has calmed", 90], ["no reading for 300 s", null], [null, null]].map(([why, release_in_s]) => {
        const tracker = { wind: [{ name: "roof", ...speeds, why, release_in_s }] };
        card.update({ tracker, extra: 30, old: false });
        return [...card.node.querySelectorAll("dd")].at(-1).textContent;
      });
    }""")
    assert said == [
        f"wind has calmed; let go in 1:00{FIRM}min if it stays calm",
        "no reading for 300 s",
        "not asked for",
    ]


def test_times_in_the_sentences_of_a_service_are_shown_in_local_time_as_the_pages_own(browser, tmp_path):
    with browser.new_context(timezone_id="Europe/Paris") as context:
        page = MadeSite(tmp_path).open(context, MIDNIGHT)
        said = page.page.evaluate("""async () => {
          const { hero } = await import("/static/js/views/hero.js");
          const { log } = await import("/static/js/views/cards.js");
          const { Orders } = await import("/static/js/orders.js");
          const why = "stopped by ben since 2022-09-21 08:18:05 UTC: at 9999-99-99 09:00 UTC I am back";
          const since = "2022-09-21T08:18:05Z";
          const alarm = { name: "cube-face", severity: "warning", state: "raised", tracker: null, since,
            text: "the south face reads 0 since 2022-09-20 21:10 UTC (south)" };
          const wishes = { hold: { since, why: "other release since 2022-09-20 23:10 UTC" } };
          const tracker = { mode: { name: "hold", since, why }, wishes, tracker: { name: "roof" } };
          const [now, state] = [Date.parse("2022-09-21T09:00:00Z"), { alarms: [alarm], trackers: { roof: tracker } }];
          const [head, news] = [hero(null), log()];
          head.update({ state, entry: { key: "made" }, tracker, now });
          news.update({ state: { ...state, news: [{ time: since, text: `control: ${why}` }] }, tracker, now });
          const outcome = document.createElement("div");
          new Orders(outcome, () => {}, () => 0).say(`auto: released: ${why}`, "ok");
          const texts = (node, which) => [...node.querySelectorAll(which)].map((each) => each.textContent);
          const shown = texts(head.node, ".why, .told > p:not(.hint), .wish p");
          return [...shown, ...texts(news.node, "li > span"), ...texts(outcome, "p")];
        }""")
    said = [text.replace(FIRM, " ") for text in said]
    begun = "topped by ben since 10:18 local (08:18 UTC): at 9999-99-99 09:00 UTC I am back"
    assert said == [
        f"S{begun}",
        "The south face reads 0 since 2022-09-20 23:10 local (21:10 UTC) (south)",
        "Held since 10:18 local (08:18 UTC): other release since 01:10 local (23:10 UTC). Ends with Auto.",
        f"Control: s{begun}",
        f"Auto: released: s{begun}",
    ]


def test_no_line_breaks_between_a_number_and_its_unit(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    broken = page.page.evaluate("""async () => {
      const { hero } = await import("/static/js/views/hero.js");
      const { wind } = await import("/static/js/views/cards.js");
      const [head, gusts] = [hero(null), wind()];
      document.querySelector("#view").replaceChildren(head.node, gusts.node);
      const since = "2022-09-21T08:00:00Z";
      const limits = { stow_from_m_s: 15, release_below_m_s: 10 };
      const speeds = { speed_m_s: 3, ...limits, age_s: 1, why: "calm", release_in_s: 90 };
      const units = { wishes: {}, tracker: { name: "roof" }, wind: [{ name: "roof", ...speeds }] };
      const tracker = { mode: { name: "hold", since, why: "x" }, ...units };
      const whole = /\\d\\s(s|min|h|d|m\\/s|local|UTC)(?![a-z])/g;
      const found = new Set();
      for (const lasted_s of [1.9, 73, 240, 43200, 200000]) {
        const now = Date.parse(since) + 1000 * lasted_s;
        const context = { state: { alarms: [] }, entry: { key: "made" }, tracker, now };
        for (const card of [head, gusts]) card.update({ ...context, extra: lasted_s });
        for (let width = 296; width < 420; width += 3) {
          document.querySelector("#view").style.width = `${width}px`;
          const texts = document.createTreeWalker(document.querySelector("#view"), NodeFilter.SHOW_TEXT);
          while (texts.nextNode()) {
            for (const { 0: words, index } of texts.currentNode.data.matchAll(whole)) {
              const range = document.createRange();
              range.setStart(texts.currentNode, index);
              range.setEnd(texts.currentNode, index + words.length);
              if (range.getClientRects().length > 1) found.add(words);
            }
          }
        }
      }
      return [...found];
    }""")
    assert broken == []
