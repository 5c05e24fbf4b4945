"""A real browser on the dashboard of a real service on a bench: Debian's chromium, driven by playwright."""

import contextlib
import os
import shutil
import signal
from dataclasses import dataclass
from pathlib import Path

import httpx
from playwright.sync_api import expect, sync_playwright

from tests.support import PATIENCE_S
from tests.support.addresses import free_port
from tests.system.processes import BenchProcess, Process, wait_until
from tests.system.rig import BRISK, HIGH_SUN

# The chromium without a window takes a third less of a processor than the whole one.
CHROMIUM = shutil.which("chromium-headless-shell") or shutil.which("chromium")
TOKEN = "t" * 43
PHONE = {"width": 390, "height": 844}
TABLET = {"width": 820, "height": 1180}
DESKTOP = {"width": 1440, "height": 900}
# A limit for a program that hangs, not for a slow machine.
WITHIN_MS = 1000 * PATIENCE_S
expect.set_options(timeout=WITHIN_MS)
# No certificates are read, which takes longer than a service's answer, and no connection is kept.
WEB = httpx.Client(timeout=PATIENCE_S, trust_env=False, verify=False, headers={"Connection": "close"})

SIMULATED = """
[site]
latitude_deg = 10.0
longitude_deg = 0.0
[cube]
scan_every_s = 2.0
reading_deadline_s = 0.5
dark_correction = false
[instruments.multiplexer]
settle_s = 0.02
[instruments.voltmeter]
nplc = 0.1
[windows]
mean_s = 4.0
decide_every_s = 20.0
[motion]
minimum_interval_s = 0.0
[bridge]
listen = "127.0.0.1:0"
send_to = []
insecure = true
[simulation]
speed = 1.0
weather = "clear"
start_utc = 2022-09-21T11:50:00Z
motor_speed_mm_s = 12.8
"""
"""A simulated rig at its own speed, which scans every two seconds; the sun is high, so that stow is near."""


class Page:
    """A page of the dashboard, with everything that it asked for and complained about."""

    def __init__(self, context, url, view="now"):
        self.page = context.new_page()
        self.url = url
        self.complaints, self.asked = [], []
        self.page.on("console", self._note)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(f"{url}/#{view}")

    def _note(self, message):
        # A service that is gone and a wrong token are not the page's mistakes.
        if message.type in ("error", "warning") and "Failed to load resource" not in message.text:
            self.complaints.append(message.text)

    def show(self, view):
        self.page.goto(f"{self.url}/#{view}")

    def sees(self, selector, text):
        try:
            expect(self.page.locator(selector).first).to_contain_text(text, timeout=WITHIN_MS)
        except AssertionError as error:
            # What a person would look at next: the state and its reason, what came of the order, what is still asked.
            shown = self.page.locator(".hero, .outcome, dialog").all_inner_texts()
            raise AssertionError(f"{error}\nThe page says: {shown}") from None

    def text(self, selector):
        return self.page.locator(selector).first.inner_text()

    def log_in(self):
        dialog = self.page.get_by_role("dialog")
        dialog.get_by_label("Your name").fill("ana")
        dialog.get_by_label("Token").fill(TOKEN)
        dialog.get_by_role("button", name="Log in").click()
        expect(dialog.get_by_label("Token")).to_have_count(0, timeout=WITHIN_MS)


@dataclass
class Site:
    """A service, and its dashboard."""

    config: Path
    api: str
    url: str
    service: Process
    dashboard: Process

    def state(self):
        return WEB.get(f"http://{self.api}/api/state").json()

    def order(self, name, **body):
        headers = {"Authorization": f"Bearer {TOKEN}"}
        return WEB.post(f"http://{self.api}/api/{name}", json=body, headers=headers).json()

    def kill(self):
        self.service.stop(signal.SIGKILL)

    def start(self):
        self.service = run_service(self.config)

    def until_mode(self, mode):
        wait_until(lambda: self.mode() == mode, lambda: f"mode {mode}, but {self.mode()}; {self.service.log()}")

    def mode(self):
        try:
            # If there are several trackers, that of the first.
            return next(iter(self.state()["trackers"].values()))["mode"]["name"]
        except httpx.HTTPError:
            return None


def run_service(config):
    output = config.with_name("service.log")
    with output.open("ab") as stream:
        return Process(["run", "--config", config], output, stdout=stream)


def run_dashboard(folder, *services):
    port = free_port()
    output = folder / "dashboard.log"
    given = [word for service in services for word in ("--api", service)]
    with output.open("ab") as stream:
        process = Process(["dashboard", *given, "--listen", f"127.0.0.1:{port}"], output, stdout=stream)
    wait_until(lambda: "dashboard at" in process.log() or process.exit_code is not None, process.log)
    return process, f"http://127.0.0.1:{port}"


def answers(url):
    """Whether a dashboard is there."""
    try:
        return WEB.get(f"{url}/healthz").is_success
    except httpx.HTTPError:
        return False


def with_interface(folder, text, last=""):
    """Write a configuration to which the interface and the store are added; return its path and the address."""
    (folder / "api.token").write_text(TOKEN + "\n")
    (folder / "api.token").chmod(0o600)
    api = f"127.0.0.1:{free_port()}"
    config = folder / "heliocube.toml"
    added = f'[api]\nlisten = "{api}"\ntoken_file = "{folder}/api.token"\n'
    config.write_text(f'{text}\n{added}[store]\ndirectory = "{folder}/records"\nbatch_s = 0.5\n{last}')
    return config, api


@contextlib.contextmanager
def run_site(config, api):
    """Run a site whose tracker tracks; everything ends with it."""
    with contextlib.ExitStack() as stack:
        service = run_service(config)
        dashboard, url = run_dashboard(config.parent, api)
        stack.callback(dashboard.stop)
        found = Site(config=config, api=api, url=url, service=service, dashboard=dashboard)
        stack.callback(lambda: found.service.stop())
        found.until_mode("tracking")
        yield found


TEN = "".join(f'[[tracker]]\nname = "t{number}"\n' for number in range(10))


def fleet_site(folder):
    """Give a site of ten trackers, t0 to t9."""
    return run_site(*with_interface(folder, SIMULATED, TEN))


def simulated_site(folder, text=SIMULATED):
    """Give a site on the simulated rig."""
    return run_site(*with_interface(folder, text))


@contextlib.contextmanager
def site_on_bench(folder):
    """Give a site whose instruments are a bench's, and the bench."""
    text = BRISK.format(send_to="", positioner="").replace("[api]\nenabled = false\n", "")
    basis, api = with_interface(folder, text)
    bench = BenchProcess(folder / "bench", "--config", basis, *HIGH_SUN)
    try:
        with run_site(bench.config, api) as found:
            yield found, bench
    finally:
        bench.stop()


def launch(kind, *options):
    """Launch the chromium of this machine through playwright."""
    # Chromium has no sandbox for root.
    given = ["--no-sandbox", "--disable-gpu", *options]
    starter = Path(__file__).with_name("chromium.sh")
    return kind.launch(executable_path=starter, args=given, env=os.environ | {"CHROMIUM": CHROMIUM})


@contextlib.contextmanager
def chromium():
    """Give a browser."""
    with sync_playwright() as playwright:
        browser = launch(playwright.chromium)
        try:
            yield browser
        finally:
            browser.close()
