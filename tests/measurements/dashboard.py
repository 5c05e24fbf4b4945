"""Measures the dashboard: how soon a full day is drawn, and what open pages cost the dashboard and the service.

    python -m tests.measurements.dashboard

A store gets a day of 17,280 scans, poses and decisions, eight series in all; chromium opens it twenty times. Then
stops are given over the interface: without a page, while twenty clients listen as pages do, and while chromium has
twenty pages open, each in a profile of its own, so that each has its own stream. Chromium draws them in software on the
same cores that are measured, at nice 19. What the drawing alone costs is measured with twenty pages of another service.
"""

import math
import os
import statistics
import tempfile
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx

from daemon.base.clock import SystemClock
from daemon.base.records import Decision, Estimate, FaceReading, Mode, Pose, Quality, Scan, Target
from daemon.store.store import Origin, Store
from tests.support import forks
from tests.system import browser as browsers

EVERY_S = 5
SCANS = 17_280
PAGES = 20
WHILE_S = 30.0
STOPS = 20
OPENED = 20
T0 = 1663718400.0  # 2022-09-21


def fill(folder):
    """Write the day."""
    origin = Origin(T0, "both", "0.1.0", True, "SIRTA", 10.0, 0.0, 0.0)
    store = Store(folder, 0.1, 400, origin, SystemClock(), print)
    nan = math.nan
    for n in range(SCANS):
        at_s = T0 + n * EVERY_S
        light = [500 + 400 * math.sin(n / (900 + 100 * face)) for face in range(4)]
        faces = [FaceReading(value, Quality.OK, at_s, float(n)) for value in light]
        a_deg, b_deg = 50 * math.sin(n / 3000), 60 + 30 * math.cos(n / 2000)
        store.keep(Scan("cube", "day", n, at_s, float(n), *faces, simulated=True))
        store.keep(Pose(at_s, float(n), a_deg, b_deg, moving=False, tracker="tracker"))
        store.keep(
            Decision(
                time_utc_s=at_s,
                time_monotonic_s=float(n),
                mode=Mode.TRACKING,
                law="mu-prime",
                irradiances=None,
                direction_azimuth_deg=nan,
                direction_elevation_deg=nan,
                sun_azimuth_deg=nan,
                sun_elevation_deg=nan,
                target=Target(a_deg + 1, b_deg - 1, ""),
                moved=False,
                estimate=Estimate(nan, nan, nan),
                tracker="tracker",
            )
        )
        while store.status.waiting > 10_000:
            time.sleep(0.05)
    store.close()


def memory_mb(process):
    """Return the resident memory of a process."""
    text = Path(f"/proc/{process.pid}/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) / 1024


@contextmanager
def listening(url):
    """Keep twenty clients listening."""
    ends, heard = threading.Event(), []
    threads = [threading.Thread(target=listen, args=(url, ends, heard)) for _ in range(PAGES)]
    for thread in threads:
        thread.start()
    yield
    ends.set()
    for thread in threads:
        thread.join()


@contextmanager
def browsing(browser, url):
    """Keep twenty pages open, and print at the end their complaints and whether they were live."""
    with ExitStack() as stack:
        contexts = [stack.enter_context(browser.new_context(viewport=browsers.PHONE)) for _ in range(PAGES)]
        pages = [browsers.Page(context, url) for context in contexts]
        for page in pages:
            page.sees(".hero .simulated", "SIMULATED")
        yield
        complaints = [complaint for page in pages for complaint in page.complaints]
        old = sum(page.page.locator("body[data-old]").count() for page in pages)
        print(f"complaints of the pages: {complaints}; pages that were not live at the end: {old}")


def listen(url, ends, heard):
    """Listen as one page does."""
    with httpx.Client(timeout=30, trust_env=False) as client, client.stream("GET", f"{url}/events") as reply:
        for part in reply.iter_raw():
            heard.append(len(part))
            if ends.is_set():
                return


def stops(site):
    """Return how long the answers to stops took [ms]."""
    found = []
    for _ in range(STOPS):
        begun_s = time.perf_counter()
        site.order("stop")
        found.append((time.perf_counter() - begun_s) * 1e3)
        site.order("auto")
        time.sleep(1.0)
    return found


def load(site, seconds):
    """Return the CPU load of dashboard and service together [% of a core]."""
    both = (site.service, site.dashboard)
    begun_s, used_s = time.monotonic(), sum(process.cpu_s() for process in both)
    time.sleep(seconds)
    return 100 * (sum(process.cpu_s() for process in both) - used_s) / (time.monotonic() - begun_s)


def said(name, values, unit):
    """Print a figure with its spread."""
    values = sorted(values)
    print(
        f"{name}: median {statistics.median(values):.0f}, {values[0]:.0f} to {values[-1]:.0f} {unit} of {len(values)}"
    )


def watched(site, what, idle=None):
    """Measure stops, lateness, load and memory while something is open; return the load."""
    time.sleep(5)
    busy, before_mb = load(site, WHILE_S), memory_mb(site.dashboard)
    said(f"stop with {what}", stops(site), "ms")
    late_ms = httpx.get(f"http://{site.api}/healthz", trust_env=False).json()["loop_late_worst_s"] * 1e3
    print(f"loop late at worst with {what}: {late_ms:.0f} ms; load of the machine {os.getloadavg()[0]:.1f}")
    each = "" if idle is None else f", {(busy - idle) / PAGES:.3f} % of a core for each"
    print(f"dashboard and service with {what}: {busy:.2f} % of a core{each}")
    print(f"memory of the dashboard with {what}: {before_mb:.0f} MB, {memory_mb(site.dashboard):.0f} at the end")
    return busy


def drawn(browser, site):
    """Measure how soon a day is drawn."""
    ready, drawing = [], []
    for _ in range(OPENED):
        with browser.new_context(viewport=browsers.DESKTOP) as context:
            page = browsers.Page(context, site.url, "day")
            page.page.wait_for_selector(".day[data-ready]", timeout=60_000)
            day = page.page.locator(".day")
            ready.append(float(day.get_attribute("data-ready")))
            drawing.append(float(day.get_attribute("data-drawn")))
    said("a day of 17,280 scans and 8 series, asked for and drawn", ready, "ms")
    said("of which drawing", drawing, "ms")
    print(f"load of the machine {os.getloadavg()[0]:.1f}")


def main():
    """Measure everything, and print it."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # With another PYTHONHASHSEED `heliocube` starts from nothing: a copy would hold all that the tests load.
        forks.begin()
        os.environ["PYTHONHASHSEED"] = "0"
        # The service starts first: records that it finds are an earlier release's for it, and hold the tracker.
        site = stack.enter_context(browsers.simulated_site(folder))
        fill(folder / "records")
        with browsers.chromium() as browser:
            drawn(browser, site)
        idle = watched(site, "no page")
        with listening(site.url):
            watched(site, f"{PAGES} listeners", idle)
        other = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        os.nice(19)
        with browsers.simulated_site(other) as another, browsers.chromium() as browser, browsing(browser, another.url):
            watched(site, f"{PAGES} pages of another service in chromium")
        with browsers.chromium() as browser, browsing(browser, site.url):
            watched(site, f"{PAGES} pages in chromium", idle)


if __name__ == "__main__":
    main()
