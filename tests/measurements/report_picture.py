"""Takes the picture of a report that docs/report.md shows: a simulated day of variable sky, by `optimal`.

    python -m tests.measurements.report_picture [DIR]

The page itself is left in DIR, to look at.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support import DOCS
from tests.system import browser as browsers

PROGRAM = Path(sys.executable).with_name("heliocube")
SHOWN = {"width": 1000, "height": 1500}


def main():
    """Simulate the day and take the picture."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="report-"))
    with tempfile.TemporaryDirectory() as folder:
        day = ("--start", "2022-10-14", "--weather", "variable", "--law", "optimal", "--out", f"{folder}/tables")
        pages = ("--report", out, "--zone", "Europe/Paris", "--force")
        subprocess.run([PROGRAM, "simulate", *day, *pages], check=True)
    with browsers.chromium() as browser, browser.new_context(viewport=SHOWN, color_scheme="light") as context:
        page = context.new_page()
        page.goto((out / "2022-10-14-tracker.html").as_uri())
        page.screenshot(path=DOCS / "report.png")
    print(f"the page is in {out}")


if __name__ == "__main__":
    main()
