"""The report in a real browser: it runs nothing, asks for nothing, and everybody can read it."""

import pytest

from daemon.studies.report.material import read_material
from daemon.studies.report.span import RequestedSpan
from tests.support.stored_day import T0, stored_days

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the report"),
]


def test_the_report_page_loads_no_other_file_runs_no_script_and_passes_the_accessibility_checks(tmp_path):
    from daemon.studies.report.write import write_reports  # noqa: PLC0415 - every process that waits would load plots

    store = stored_days(tmp_path / "store", days=2)
    materials = read_material(
        store, RequestedSpan(start="2022-10-14", end="2022-10-16"), None, T0 + 9e6, lambda _share: None
    )
    (path,) = write_reports(materials, tmp_path / "out", None, lambda _share: None, force=False)
    with browsers.chromium() as browser:
        for viewport, scheme in ((browsers.PHONE, "dark"), (browsers.DESKTOP, "light")):
            with browser.new_context(viewport=viewport, color_scheme=scheme) as context:
                opened = context.new_page()
                complaints, asked = [], []
                opened.on("console", lambda message, to=complaints: to.append(message.text))
                opened.on("pageerror", lambda error, to=complaints: to.append(str(error)))
                opened.on("request", lambda request, to=asked: to.append(request.url))
                opened.goto(path.as_uri())
                assert (complaints, asked) == ([], [path.as_uri()])
                assert opened.locator("script").count() == 0
                wide, screen = opened.evaluate("[document.documentElement.scrollWidth, innerWidth]")
                assert wide <= screen, f"{viewport}: it fits the screen"
                assert opened.locator("figure svg").count() == 6
                assert opened.locator("figure svg").first.bounding_box()["height"] > 200
                violations = axe.Axe().run(opened).response["violations"]
                assert [(found["id"], found["nodes"][0]["html"]) for found in violations] == []
