"""The view of the day in a real browser: which day it is, what is drawn of it, and how it goes on."""

import math

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from daemon.base.records import Event, FaceReading, Pose, Quality, Scan  # noqa: E402 - as below
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


@pytest.fixture(scope="module")
def browser():
    with browsers.chromium() as found:
        yield found


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


def shows(page, text):
    """Wait until a day has been chosen and drawn."""
    page.page.wait_for_function(
        "text => document.querySelector('.day select').selectedOptions[0]?.text === text", arg=text
    )
    page.sees(".day .summary", "scans")


@pytest.mark.parametrize(
    ("longitude_deg", "hour", "today", "begin"), [(150.0, 20.0, "2022-09-22", "14"), (-120.0, 5.0, "2022-09-20", "08")]
)
def test_today_is_the_day_of_the_sun_at_the_site(context, tmp_path, longitude_deg, hour, today, begin):
    site = MadeSite(tmp_path, Site(-33.0, longitude_deg, 0.0))
    now = MIDNIGHT + hour * HOUR
    site.keep(*records(now - 0.5 * HOUR, now))
    page = site.open(context, now)
    shows(page, f"{today} (today)")
    page.sees(".day .summary", "90 scans")
    page.sees(".day .hint", f"Shown: the whole solar day, {begin}:00:00 to {begin}:00:00 local time")
    assert page.complaints == []


@pytest.mark.parametrize("failures", [1, 2], ids=["the days", "the days, then the records"])
def test_what_has_failed_is_tried_again(context, tmp_path, failures):
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
    page.page.wait_for_function("document.querySelector('.day select').options.length === 4")
    shows(page, "2022-09-20")
    assert page.complaints == []
