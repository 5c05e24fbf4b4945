"""The dashboard's page in a real browser, with an artificial service whose clock and store are the test's own."""

import gzip
import json
from mimetypes import guess_type
from urllib.parse import parse_qs, urlsplit

from daemon.api.history import parse_query_time
from daemon.api.sun import sun_json
from daemon.base.clock import SystemClock, iso_utc
from daemon.base.errors import UserError
from daemon.dashboard.app import STATIC
from daemon.store.history import KINDS_OF_LINES, lines_of, packed_numbers, stored_days
from daemon.store.schema import FILE_NAME
from daemon.store.store import Origin, Store
from solar.ephemeris import Site
from tests.system import browser as browsers

URL = "http://dashboard.test"
TRACKER = "roof"

_STREAM = """
delete window.SharedWorker;
window.EventSource = class extends EventTarget {
  constructor() {
    super();
    this.every = setInterval(() => this.tell(), 1000);
    setTimeout(() => this.tell(), 0);
  }
  tell() {
    const state = { ...STATE, time: new Date().toISOString() };
    const hello = { version: "test", page: window.page ?? "", services: ["made"] };
    const said = { hello, message: { service: "made", up: true, state } };
    for (const [kind, data] of Object.entries(said)) {
      this.dispatchEvent(new MessageEvent(kind, { data: JSON.stringify(data) }));
    }
  }
  close() {
    clearInterval(this.every);
  }
};
"""


class MadeSite:
    """A store, the service that reads it, and the dashboard's page; the browser is the only other process.

    Attributes
    ----------
    failures
        How many of the next requests for stored records are refused.
    holds
        The path of the next request that gets no answer before `let_go`; None where all are answered at once.
    """

    def __init__(self, folder, site=Site(10.0, 0.0, 0.0)):  # noqa: B008 - it does not change
        self.folder, self.site, self.failures = folder, site, 0
        self.holds, self._held = None, []

    def keep(self, *records):
        """Write records, as a run of their own."""
        store = Store(self.folder, 60.0, 400, self._origin(), SystemClock(), lambda _event: None)
        for record in records:
            store.keep(record)
        store.close()

    def _origin(self):
        return Origin(
            started_utc_s=0.0, role="both", version="test", simulated=True, site="made", tracker=TRACKER,
            **self.site._asdict(),
        )  # fmt: skip

    def open(self, context, now_utc_s, mode="tracking", since_utc_s=None):
        """Open the view of the day; the page's clock starts at `now_utc_s`."""
        since = iso_utc(now_utc_s if since_utc_s is None else since_utc_s)
        unit = {"name": TRACKER, "pose": None, "moving": False, "target": None}
        said = {"name": mode, "since": since, "why": "a reason"}
        tracker = {"tracker": unit, "law": {"name": "flat"}, "wind": [], "mode": said}
        state = {"speed": 1.0, "site": {"name": "made", **self.site._asdict()}, "trackers": {TRACKER: tracker}}
        context.add_init_script(_STREAM.replace("STATE", json.dumps(state)))
        context.clock.install(time=now_utc_s)
        context.route("**/*", self._answer)
        return browsers.Page(context, URL, "day")

    def let_go(self, holds=None):
        """Answer the held requests, end holding their path, and hold the next request for another path."""
        self.holds = holds
        while self._held:
            self._answer(self._held.pop())

    def _answer(self, route):
        asked = urlsplit(route.request.url)
        if asked.path == self.holds:
            self.holds = None
            self._held.append(route)
            return
        query = {name: values[0] for name, values in parse_qs(asked.query).items()}
        if asked.path == "/session":
            route.fulfill(json={"by": None, "services": []})
        elif asked.path.startswith("/read/"):
            try:
                route.fulfill(**self._read(asked.path.removeprefix("/read/"), query))
            except UserError as error:
                route.fulfill(status=409, json={"error": str(error)})
        else:
            file = STATIC / (asked.path.removeprefix("/static/") if asked.path != "/" else "index.html")
            # Given a path, playwright would leave threads behind that read it.
            route.fulfill(body=file.read_bytes(), content_type=guess_type(file.name)[0])

    def _read(self, what, query):
        store = self.folder / FILE_NAME
        if what == "sun":
            return {"json": sun_json(self.site, parse_query_time("at", query["at"]))}
        if self.failures:
            self.failures -= 1
            return {"status": 502, "json": {"error": "the service cannot be reached"}}
        if what == "days":
            return {"json": {"days": stored_days(store, self.site.longitude_deg)}}
        kind = what.removeprefix("history/")
        span = (parse_query_time("from", query["from"]), parse_query_time("to", query["to"]), query["tracker"])
        if kind in KINDS_OF_LINES:
            return {"json": lines_of(store, kind, *span)}
        return {"body": gzip.decompress(packed_numbers(store, kind, *span))}
