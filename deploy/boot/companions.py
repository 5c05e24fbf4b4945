"""Points about the units beside the two services: dashboard, alarms to people, the nightly report."""

import json

from boot.host import CheckFailed, wait
from boot.machine import Machine

SILENT_AFTER_S = 10.0
WEBHOOK_PORT = 20600
WEBHOOK_LOG = "/run/letters"

WEBHOOK_RECEIVER = f"""
import http.server
class Taker(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        with open("{WEBHOOK_LOG}", "ab") as file:
            file.write(body.replace(b"\\n", b" ") + b"\\n")
        self.send_response(200)
        self.end_headers()
http.server.HTTPServer(("127.0.0.1", {WEBHOOK_PORT}), Taker).serve_forever()
"""
FETCH = "import sys, urllib.request; print(urllib.request.urlopen(sys.argv[1], timeout=20).read(2000).decode())"


class Companions:
    """Units with users of their own, to which systemd hands what they may read.

    Parameters
    ----------
    machine
        Booted, with a tracker at work.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def start(self) -> str:
        """See that dashboard and alarms say by notify that they are ready."""
        self._machine.write("/opt/letterbox.py", WEBHOOK_RECEIVER)
        self._machine.run("systemd-run", "--quiet", "--unit=letterbox", "python3", "/opt/letterbox.py")
        self._machine.write("/etc/heliocube/notify.people", f"json://127.0.0.1:{WEBHOOK_PORT}/\n", 0o600)
        notify = self._machine.root / "etc/heliocube/notify.toml"
        notify.write_text(notify.read_text(encoding="utf-8") + f"silent_after_s = {SILENT_AFTER_S}\n", encoding="utf-8")
        units = ("heliocube-dashboard.service", "heliocube-notify.service")
        self._machine.systemctl("enable", "--now", "--no-block", *units)
        took_s = max(self._machine.wait_active(unit) for unit in units)
        users = {self._machine.show(unit, "DynamicUser")["DynamicUser"] for unit in units}
        if users != {"yes"}:
            raise CheckFailed("they run as a user that is not their own")
        return f"both active by notify after {took_s:.1f} s, each as a user of its own"

    def check_dashboard_page(self) -> str:
        """See that the dashboard gives its page to a client on loopback."""
        page = self._machine.run("python3", "-c", FETCH, "http://127.0.0.1:20574/")
        if "<title" not in page:
            raise CheckFailed(f"no page: {page[:200]!r}")
        return page.partition("<title>")[2].partition("</title>")[0].strip()

    def check_silence_notice(self) -> str:
        """See that people are told of a service that has fallen silent, as a frozen one has."""
        return f'"{self._letter("127.0.0.1:20572")}"'

    def _letter(self, word: str) -> str:
        def found() -> str:
            lines = self._machine.run_unchecked("cat", WEBHOOK_LOG).stdout.splitlines()
            letters = [json.loads(line) for line in lines]
            titles = [f"{letter.get('title', '')} {letter.get('message', '')}" for letter in letters]
            return next((title[:100] for title in titles if word in title), "")

        return wait(found, f"a message about {word}")

    def check_nightly_report(self) -> str:
        """See that the timer is armed, and that its service does its work when it is started as the timer does."""
        self._machine.systemctl("enable", "--now", "heliocube-report.timer")
        armed = self._machine.show("heliocube-report.timer", "NextElapseUSecRealtime", "ActiveState")
        if armed["ActiveState"] != "active" or not armed["NextElapseUSecRealtime"]:
            raise CheckFailed(f"the timer is not armed: {armed}")
        unit = "heliocube-report.service"
        self._machine.run_unchecked("systemctl", "start", unit)
        pages = sorted((self._machine.root / "var/lib/heliocube/reports").glob("*.html"))
        result = self._machine.show(unit, "Result")["Result"]
        if result != "success" or not pages:
            raise CheckFailed(f"{result}: {self._machine.journal(unit, 4)}")
        size_kb = pages[-1].stat().st_size / 1000
        return f"next {armed['NextElapseUSecRealtime']}; run now it wrote {pages[-1].name}, {size_kb:.0f} kB"
