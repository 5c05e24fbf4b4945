"""The view of the day in a real browser: which day it is, what is drawn of it, and how it goes on."""

import math

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from daemon.base.records import Event, FaceReading, Mode, ModeChange, Pose, Quality, Scan  # noqa: E402 - as below
from solar.ephemeris import Site  # noqa: E402 - as below
from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import TRACKER, MadeSite  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

MIDNIGHT = 1663718400.0
"""2022-09-21T00:00Z."""
HOUR = 3600.0
OUTAGE = (MIDNIGHT + 2 * HOUR, MIDNIGHT + 6 * HOUR)

# `share` is a place in the day, 0 to 1 of the plot's width. Pixels that are coloured, or darker than any grid, are a
# line; translucent ones over more than a line's width are a strip.
LINED = """([number, share]) => {
  const plot = document.querySelectorAll(".plot")[number];
  const canvas = plot.querySelector("canvas");
  const area = plot.querySelector(".u-over").getBoundingClientRect();
  const scale = canvas.width / canvas.getBoundingClientRect().width;
  const x = Math.round((area.left + share * area.width - canvas.getBoundingClientRect().left) * scale);
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(x, 0, 1, canvas.height);
  let translucent = 0;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] > 90 && data[i + 3] < 150) translucent += 1;
    const [most, least] = [Math.max(...data.slice(i, i + 3)), Math.min(...data.slice(i, i + 3))];
    if (data[i + 3] > 90 && (most - least > 50 || most < 90)) return true;
  }
  return translucent > 8;
}"""
INKED = """() => {
  const [red, green, blue] = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim()
    .match(/\\w\\w/g).map((part) => parseInt(part, 16));
  const canvas = document.querySelector(".plot canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  let found = 0;
  for (let i = 0; i < data.length; i += 4) {
    const away = Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue);
    if (data[i + 3] > 200 && away < 60) found += 1;
  }
  return found;
}"""


@pytest.fixture
def context(browser):
    with browser.new_context(viewport=browsers.DESKTOP, timezone_id="UTC") as found:
        yield found


def scan(at):
    level = 500.0 + 300.0 * math.sin(at / 7000.0)
    east, south, west, zenith = (FaceReading(level + 40.0 * face, Quality.OK, at, at) for face in range(4))
    return Scan(
        source="cube", session="s", sequence=int(at), time_utc_s=at, time_monotonic_s=at,
        east=east, south=south, west=west, zenith=zenith, simulated=True,
    )  # fmt: skip


def records(start, end, every_s=20.0):
    """Scans and poses from one instant to another."""
    for number in range(int((end - start) / every_s)):
        at = start + every_s * number
        yield scan(at)
        yield Pose(at, at, 20.0, 60.0, False, TRACKER, 5.0 if number % 3 else math.nan)


def change(at, before, after):
    return ModeChange(at, at, before, after, "a reason", TRACKER)


def shows(page, text):
    """Wait until a day has been chosen and drawn."""
    page.page.wait_for_function(
        "text => document.querySelector('.day select').selectedOptions[0]?.text === text", arg=text
    )
    page.sees(".day .summary", "scans")


@pytest.mark.parametrize(
    ("longitude_deg", "hour", "today", "begin"), [(150.0, 20.0, "2022-09-22", "14"), (-120.0, 5.0, "2022-09-20", "08")]
)
def test_today_is_the_present_solar_day_at_the_site(context, tmp_path, longitude_deg, hour, today, begin):
    site = MadeSite(tmp_path, Site(-33.0, longitude_deg, 0.0))
    now = MIDNIGHT + hour * HOUR
    site.keep(*records(now - 0.5 * HOUR, now))
    page = site.open(context, now)
    shows(page, f"{today} (today)")
    page.sees(".day .summary", "90 scans")
    page.sees(".day .hint", f"Shown: the whole solar day, {begin}:00:00 to {begin}:00:00 local time")
    assert page.complaints == []


def test_the_day_view_draws_and_counts_nothing_for_a_time_without_records(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, OUTAGE[0]))
    site.keep(
        *records(OUTAGE[1], MIDNIGHT + 9 * HOUR),
        change(MIDNIGHT + 8 * HOUR, Mode.NIGHT, Mode.TRACKING),
    )
    page = site.open(context, MIDNIGHT + 9.5 * HOUR)
    shows(page, "2022-09-21 (today)")
    page.sees(".day .summary", "Night 2 h 0 min, Tracking 1 h 0 min.")
    titles = page.page.locator(".plot figcaption").all_inner_texts()
    assert [title.split()[0] for title in titles] == ["Irradiance", "Angle", "Angle", "Wind,", "Modes,"]
    for number, title in enumerate(titles):
        lined = {hour: page.page.evaluate(LINED, [number, hour / 24.0]) for hour in (1.0, 3.9, 7.0, 8.5, 9.2)}
        # No record tells the mode of the first stretch. The sun's path is calculated, so it is known at 9.2 too.
        wanted = {1.0: number != 4, 3.9: False, 7.0: True, 8.5: True, 9.2: number in (1, 2)}
        assert lined == wanted, title
    assert page.complaints == []


def test_the_plots_of_a_day_fit_a_screen_of_320_pixels(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT + 22 * HOUR, MIDNIGHT + 23 * HOUR))
    page = site.open(context, MIDNIGHT + 23 * HOUR)
    shows(page, "2022-09-21 (today)")
    page.page.set_viewport_size({"width": 320, "height": 640})
    page.page.wait_for_function(
        """() => {
            const end = (part) => part.getBoundingClientRect().right;
            const ends = [...document.querySelectorAll(".plot canvas")].map(end);
            const right = end(document.querySelector(".plots"));
            return right < 320 && ends.length > 0 && ends.every((one) => one <= right);
        }"""
    )
    assert page.complaints == []


def test_the_page_uses_the_font_size_that_is_set_in_the_browser(browser, tmp_path):
    large = browsers.launch(browser.browser_type, "--blink-settings=defaultFontSize=32")
    try:
        page = MadeSite(tmp_path).open(large.new_context(viewport=browsers.DESKTOP), MIDNIGHT)
        page.sees(".day", "No stored day to show")
        size = "parseFloat(getComputedStyle(document.documentElement).fontSize)"
        assert page.page.evaluate(size) == pytest.approx(32, abs=2)
        # A desktop with large letters has the room of a phone.
        width = page.page.evaluate("document.documentElement.scrollWidth")
        assert width == browsers.DESKTOP["width"]
    finally:
        large.close()


def test_the_lines_of_the_four_faces_differ_in_width_or_style_so_that_they_differ_in_grey_too(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + HOUR))
    page = site.open(context, MIDNIGHT + HOUR)
    shows(page, "2022-09-21 (today)")
    # The first key is the time's, which has no line.
    keys = page.page.locator(".plot").first.locator(".u-marker")
    lines = keys.evaluate_all("keys => keys.slice(1).map(({ style }) => `${style.borderWidth} ${style.borderStyle}`)")
    assert len(lines) == len(set(lines)) == 4


def test_a_mode_that_began_before_the_day_is_counted_without_a_change_of_mode_that_day(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + 2 * HOUR))
    page = site.open(context, MIDNIGHT + 2 * HOUR, "maintenance", MIDNIGHT - HOUR)
    page.sees(".day .summary", "0 moves over 0.0°. Maintenance 2 h 0 min.")


def test_the_summary_of_a_day_without_known_modes_does_not_mention_modes(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + HOUR))
    page = site.open(context, MIDNIGHT + 2 * HOUR)
    page.sees(".day .summary", "0 moves over 0.0°.")
    assert page.text(".day .summary").endswith("0 moves over 0.0°.")


@pytest.mark.parametrize("failures", [1, 2], ids=["the days", "the days, then the records"])
def test_a_failed_request_for_the_days_or_the_records_is_repeated(context, tmp_path, failures):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + HOUR))
    site.failures = failures
    page = site.open(context, MIDNIGHT + HOUR)
    for _ in range(failures):
        page.sees(".day", "No stored day to show")
        page.page.clock.fast_forward(11_000)
    shows(page, "2022-09-21 (today)")
    assert page.complaints == []


def test_at_midnight_the_new_day_is_opened_unless_another_one_was_chosen(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT - HOUR, MIDNIGHT), *records(MIDNIGHT + 23 * HOUR, MIDNIGHT + 23.9 * HOUR))
    page = site.open(context, MIDNIGHT + 24 * HOUR - 30.0)
    shows(page, "2022-09-21 (today)")
    site.keep(Event(MIDNIGHT + 24 * HOUR + 1.0, 0.0, "made", "the day has begun", TRACKER))
    page.page.clock.fast_forward(70_000)
    page.sees(".day .log", "the day has begun")
    shows(page, "2022-09-22 (today)")
    page.page.get_by_label("Day", exact=True).select_option("2022-09-20")
    page.sees(".day .summary", "180 scans")
    site.keep(Event(MIDNIGHT + 48 * HOUR + 1.0, 0.0, "made", "one more", TRACKER))
    page.page.clock.fast_forward(24 * HOUR * 1e3)
    page.page.wait_for_function("() => document.querySelector('.day select').options.length === 4")
    shows(page, "2022-09-20")
    assert page.complaints == []


def test_a_day_view_that_is_left_while_it_loads_leaves_no_plots_behind(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + HOUR))
    page = site.open(context, MIDNIGHT + HOUR)
    shows(page, "2022-09-21 (today)")
    page.show("fleet")
    site.holds = "/read/history/events"
    with page.page.expect_request("**/read/history/events*"):
        page.show("day")
    page.show("fleet")
    page.sees(".fleet tbody", TRACKER)
    # The answer to the first request comes before the page asks anything for the second.
    page.show("day")
    site.let_go()
    shows(page, "2022-09-21 (today)")
    kept, shown = page.page.evaluate("[uPlot.sync('day').plots.length, document.querySelectorAll('.plot').length]")
    assert kept == shown > 0
    assert page.complaints == []


def test_a_list_of_more_than_200_events_of_a_day_is_shortened_and_shown_in_full_on_request(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*(Event(MIDNIGHT + 10.0 * number, 0.0, "made", f"number {number}", TRACKER) for number in range(250)))
    page = site.open(context, MIDNIGHT + HOUR)
    lines = page.page.locator(".day .log li")
    playwright.expect(lines).to_have_count(200)
    page.page.get_by_role("button", name="Show all 250").click()
    playwright.expect(lines).to_have_count(250)
    page.sees(".day .log li:last-child", "number 0")
    assert page.complaints == []


def test_the_page_says_that_a_day_is_loading_until_it_is_shown(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT - HOUR, MIDNIGHT), *records(MIDNIGHT, MIDNIGHT + HOUR))
    site.holds = "/read/days"
    page = site.open(context, MIDNIGHT + HOUR)
    page.sees(".day .hint", "Loading ...")
    site.let_go("/read/history/events")
    page.sees(".day .hint", "Loading 2022-09-21 ...")
    site.let_go()
    page.sees(".day .hint", "Shown: ")
    site.holds = "/read/history/events"
    page.page.get_by_label("Day before").click()
    page.sees(".day .hint", "Loading 2022-09-20 ...")
    site.let_go()
    page.sees(".day .hint", "Shown: ")
    assert page.complaints == []


def test_the_plots_are_redrawn_when_the_colour_scheme_changes(context, tmp_path):
    site = MadeSite(tmp_path)
    site.keep(*records(MIDNIGHT, MIDNIGHT + 2 * HOUR))
    page = site.open(context, MIDNIGHT + 2 * HOUR)
    shows(page, "2022-09-21 (today)")
    assert page.page.evaluate(INKED) > 20
    page.page.emulate_media(color_scheme="dark")
    page.page.wait_for_function(f"() => ({INKED})() > 20")
    for _ in range(2):
        page.page.locator("#theme").click()
        page.page.wait_for_function(f"() => ({INKED})() > 20")


def test_one_of_several_trackers_shows_only_its_own_news_and_those_of_the_cube(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { log } = await import("/static/js/views/cards.js");
      const card = log();
      const texts = ["alarm: raised cube-face: the south face", "east: night -> tracking: x", "west: moved to A +1.0"];
      const news = texts.map((text, minute) => ({ time: `2022-09-21T00:0${minute}:00Z`, text }));
      const tracker = { tracker: { name: "east" } };
      card.update({ state: { news, trackers: { east: tracker, west: {} } }, tracker, now: Date.parse(news[0].time) });
      return [...card.node.querySelectorAll("li > span")].map((each) => each.textContent);
    }""")
    assert said == ["east: night -> tracking: x", "Alarm: raised cube-face: the south face"]


def test_the_mount_card_is_hidden_for_a_process_of_the_cube_alone(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    hidden = page.page.evaluate("""async () => {
      const { mount } = await import("/static/js/views/mount.js");
      const [card, site] = [mount(), { latitude_deg: 10 }];
      const tracker = { tracker: { limits: {} }, mode: { name: "night" } };
      return [{ state: { site } }, { state: null }, { state: { site }, tracker }].map((context) => {
        card.update(context);
        return card.node.hidden;
      });
    }""")
    assert hidden == [True, False, False]


@pytest.mark.parametrize(
    ("alarm", "cube_down_why", "headline"),
    [
        ({"state": "raised", "severity": "critical"}, None, "2 trackers: 1 needs attention"),
        ({"state": "cleared", "severity": "warning"}, None, "2 trackers: 1 needs attention"),
        ({"state": "acknowledged", "severity": "critical"}, None, "2 trackers: none needs attention"),
        ({"state": "raised", "severity": "notice"}, None, "2 trackers: none needs attention"),
        (None, "unplugged", "2 trackers: 1 needs attention"),
        (None, None, "2 trackers: none needs attention"),
    ],
)
def test_an_unacknowledged_alarm_above_a_notice_and_a_cube_that_is_down_need_attention(
    context, tmp_path, alarm, cube_down_why, headline
):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    alarms = [{"name": "positioner-down", "tracker": "east", **alarm}] if alarm else []
    said = page.page.evaluate(
        """async ([alarms, cube_down_why]) => {
          const { fleet } = await import("/static/js/views/fleet.js");
          const own = (name, mode) => ({
            tracker: { name, moving: false, target: null, pose: null }, mode: { name: mode, why: "x" },
            law: { name: "x" }, wind: [],
          });
          const trackers = { east: own("east", "starting"), west: own("west", "night") };
          const site = { name: "made", latitude_deg: 10 };
          const service = { name: "s", up: true, at: performance.now(), state: { trackers, alarms, site } };
          const cube = { ...service, name: "c", state: { trackers: {}, alarms: [], site, cube_down_why, scan: null } };
          const rows = Object.keys(trackers).map((key) => ({ key, label: key, service, tracker: trackers[key] }));
          const view = fleet(null);
          const all = [...rows, { key: "c", label: "cube", service: cube, tracker: null }];
          view.update({ trackers: all, live: { connected: true } });
          return view.node.querySelector("h1").textContent;
        }""",
        [alarms, cube_down_why],
    )
    assert said == headline


@pytest.mark.parametrize(
    ("own", "told"),
    [
        ({"cube_down_why": "unplugged"}, "2 trackers: 2 need attention|hold, cube down|tracking, cube down"),
        (
            {"bridge": {}, "scan": {"stale": True}},
            "2 trackers: none needs attention|hold, cube silent|tracking, cube silent",
        ),
        ({"bridge": {}, "scan": {"stale": False}}, "2 trackers: none needs attention|hold|tracking"),
        ({"bridge": {}, "scan": None}, "2 trackers: none needs attention|hold|tracking"),
    ],
)
def test_the_fleet_view_marks_trackers_whose_cube_is_down_or_silent_in_every_mode(context, tmp_path, own, told):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate(
        """async (own) => {
          const { fleet } = await import("/static/js/views/fleet.js");
          const unit = (name, mode) => ({
            tracker: { name, moving: false, target: null, pose: null }, mode: { name: mode, why: "x" },
            law: { name: "x" }, wind: [],
          });
          const trackers = { east: unit("east", "hold"), west: unit("west", "tracking") };
          const state = { trackers, alarms: [], site: { name: "made", latitude_deg: 10 }, cube_down_why: null, ...own };
          const service = { name: "s", up: true, at: { running: performance.now(), wall: Date.now() }, state };
          const rows = Object.keys(trackers).map((key) => ({ key, label: key, service, tracker: trackers[key] }));
          const view = fleet(null);
          view.update({ trackers: rows, live: { connected: true } });
          const modes = [...view.node.querySelectorAll("td[data-name=Mode]")].map((each) => each.textContent);
          return [view.node.querySelector("h1").textContent, ...modes].join("|");
        }""",
        own,
    )
    assert said == told


def test_an_unknown_gain_is_shown_as_a_dash(context, tmp_path):
    page = MadeSite(tmp_path).open(context, MIDNIGHT)
    said = page.page.evaluate("""async () => {
      const { next } = await import("/static/js/views/cards.js");
      const card = next();
      const received = { known_s: 0, actual_kwh_m2: 0, chronometric_kwh_m2: 0, best_kwh_m2: 0, gain: null };
      const told = { next_decision_s: null, law: { name: "x" }, mode: { name: "night" }, decision: null };
      card.update({ tracker: { ...told, received } });
      return card.node.textContent;
    }""")
    assert "Against chronometric–; by the model" in said
