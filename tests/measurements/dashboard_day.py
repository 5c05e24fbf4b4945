"""Measures whether a page of the dashboard survives a day: its memory, nodes and listeners should not grow.

    python -m tests.measurements.dashboard_day [MESSAGES]

The page is the real one in chromium, and its first state comes from a real service. After that its stream is
artificial: a state for every second of a day, 86,400 of them, as fast as the page takes them, with readings, poses and
news that change all the time, and alarms, stops and losses of the service that come and go. At the end the views are
changed 200 times.
"""

import sys
import tempfile
import time
from pathlib import Path

from tests.system import browser as browsers

A_DAY = 86_400
PARTS = 8
VIEWS = ("now", "day", "fleet", "control")

SCRIPT = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


def page_of(browser, url, view="now"):
    """Open a page with an artificial stream."""
    context = browser.new_context(viewport=browsers.DESKTOP, bypass_csp=True)
    context.add_init_script(SCRIPT)
    return browsers.Page(context, url, view)


def live(page, state, begin, end):
    """Let the page live through these seconds of a day."""
    page.page.evaluate("(given) => window.live(given)", {"state": state, "from": begin, "to": end})


def size_of(page):
    """Return the page's memory [MB] after the garbage is collected, its nodes and its listeners."""
    session = page.page.context.new_cdp_session(page.page)
    session.send("Performance.enable")
    session.send("HeapProfiler.collectGarbage")
    found = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
    session.detach()
    return round(found["JSHeapUsedSize"] / 2**20, 2), int(found["Nodes"]), int(found["JSEventListeners"])


def main():
    """Measure, and print the sizes."""
    messages = int(sys.argv[1]) if len(sys.argv) > 1 else A_DAY
    with tempfile.TemporaryDirectory() as folder, browsers.simulated_site(Path(folder)) as site:
        state = site.state()
        with browsers.chromium() as browser:
            page = page_of(browser, site.url)
            live(page, state, 0, 900)
            print("second of the day: memory [MB], nodes, listeners of the page")
            print(f"{900:6}: {size_of(page)}")
            begun_s = time.monotonic()
            for part in range(PARTS):
                begin, end = (900 + (messages - 900) * each // PARTS for each in (part, part + 1))
                live(page, state, begin, end)
                print(f"{end:6}: {size_of(page)}", flush=True)
            each_ms = 1e3 * (time.monotonic() - begun_s) / (messages - 900)
            print(f"a state is taken, and the page brought up to date, in {each_ms:.2f} ms")
            for number in range(200):
                page.show(VIEWS[number % len(VIEWS)])
                page.page.wait_for_timeout(30)
            page.show("now")
            live(page, state, messages, messages + 60)
            print(f"after 200 changes of the view: {size_of(page)}")
            print(f"complaints: {page.complaints}")


if __name__ == "__main__":
    main()
