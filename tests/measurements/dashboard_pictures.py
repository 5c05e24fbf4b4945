"""Takes the pictures of the dashboard that docs/dashboard.md shows, and pictures of other states to look at.

    python -m tests.measurements.dashboard_pictures [DIR]

The pictures show ten simulated trackers, each view on phone, tablet and desktop, light and dark; then a stop, and a
service that does not answer. Pictures for the docs are written to docs/dashboard.
"""

import sys
import tempfile
from pathlib import Path

from tests.support import DOCS
from tests.system import browser as browsers

SIZES = {"phone": browsers.PHONE, "tablet": browsers.TABLET, "desktop": browsers.DESKTOP}
VIEWS = {
    "now": ".card[aria-label=Sky]",
    "day": ".day[data-ready]",
    "fleet": ".fleet tbody tr",
    "control": ".order.auto",
}
FAST = browsers.SIMULATED.replace("speed = 1.0", "speed = 60.0").replace("11:50", "06:30").replace("= 10.0", "= 48.7")
SHOWN = {"now-desktop-light", "now-phone-dark", "control-phone-light", "fleet-desktop-light", "day-desktop-light"}


def take(page, out, name):
    """Take one picture."""
    page.page.wait_for_timeout(1500)
    full = not name.startswith(("now-phone", "control-phone"))
    page.page.screenshot(path=out / f"{name}.png", full_page=full)
    if name in SHOWN:
        (DOCS / "dashboard").mkdir(exist_ok=True)
        page.page.screenshot(path=DOCS / "dashboard" / f"{name}.png", full_page=full)


def main():
    """Take all pictures."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="dashboard-"))
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browsers.chromium() as browser:
        made = browsers.with_interface(Path(folder), FAST, browsers.TEN)
        with browsers.run_site(*made) as site:
            site.order("stow", tracker="t6", by="ana", why="new bearing")
            first = browsers.Page(browser.new_context(), site.url)
            first.page.wait_for_timeout(400_000 / 60 * 4)
            for size, viewport in SIZES.items():
                for scheme in ("light", "dark"):
                    with browser.new_context(
                        viewport=viewport, color_scheme=scheme, timezone_id="Europe/Paris"
                    ) as context:
                        page = browsers.Page(context, site.url)
                        for view, selector in VIEWS.items():
                            page.show(view)
                            page.page.wait_for_selector(selector, timeout=60_000)
                            take(page, out, f"{view}-{size}-{scheme}")
            with browser.new_context(viewport=browsers.PHONE) as context:
                page = browsers.Page(context, site.url)
                site.order("stop", by="ben", why="somebody at the axes")
                page.sees(".hero h1", "Stopped")
                take(page, out, "stopped")
                site.kill()
                page.sees(".hero h1", "No connection")
                take(page, out, "lost")
    print(f"pictures in {out}")


if __name__ == "__main__":
    main()
