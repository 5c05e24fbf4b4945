"""What the page says in a real browser: where it has a button for something, its texts name the button, no command."""

import pytest

from daemon.base.alarms.kinds import KINDS, with_tracker_option

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from tests.system import browser as browsers  # noqa: E402 - it needs playwright
from tests.system.made_page import MadeSite  # noqa: E402 - as above

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(browsers.CHROMIUM is None, reason="chromium is not installed: no browser for the dashboard"),
]

MIDNIGHT = 1663718400.0
"""2022-09-21T00:00Z."""
SHOWN = """async ([remedies, why]) => {
  const { hero } = await import("/static/js/views/hero.js");
  const { log } = await import("/static/js/views/cards.js");
  const { Orders } = await import("/static/js/orders.js");
  const since = "2022-09-20T23:00:00Z";
  const alarm = { name: "x", severity: "warning", state: "raised", text: why, since, tracker: "t7" };
  const tracker = { mode: { name: "hold", since, why }, wishes: {}, tracker: { name: "t7" } };
  const state = { alarms: remedies.map((remedy) => ({ ...alarm, remedy })), trackers: {} };
  state.news = [{ time: since, text: why }];
  const context = { state, entry: { key: "made" }, tracker, now: Date.parse(since) };
  const [head, news, outcome] = [hero(null), log(), document.createElement("div")];
  for (const card of [head, news]) card.update(context);
  new Orders(outcome, () => {}, () => 0).say(why, "bad");
  const texts = (node, which) => [...node.querySelectorAll(which)].map((each) => each.textContent);
  const told = [...texts(head.node, ".why"), ...texts(news.node, "li > span"), ...texts(outcome, "p")];
  return { remedies: texts(head.node, ".told p:nth-of-type(2)"), told };
}"""


TWO_ALARMS = """async () => {
  const { hero } = await import("/static/js/views/hero.js");
  const { Orders } = await import("/static/js/orders.js");
  const given = [];
  window.fetch = async (path, { body } = {}) => {
    if (body) given.push(JSON.parse(body).alarm);
    return new Response(JSON.stringify({ by: "ana", services: ["made"], text: "acknowledged", state: "done" }));
  };
  const orders = new Orders(document.createElement("div"), () => {}, () => 0);
  orders.set({ by: "ana", services: ["made"] });
  const since = "2022-09-20T23:00:00Z";
  const alarm = { severity: "critical", state: "raised", text: "x", since, tracker: "t7" };
  const alarms = ["move-failed", "driver-hung"].map((name) => ({ ...alarm, name }));
  const tracker = { mode: { name: "hold", since, why: "x" }, wishes: {}, tracker: { name: "t7" } };
  const entry = { key: "made", label: "t7", service: { name: "made" } };
  const head = hero(orders);
  const tap = (shown) => {
    head.update({ state: { alarms: shown, trackers: {} }, entry, tracker, now: Date.parse(since) });
    head.node.querySelector(".alarm button").click();
  };
  tap(alarms);
  tap(alarms.slice(1));
  const twice = [...given];
  await new Promise((later) => setTimeout(later, 600));
  tap(alarms.slice(1));
  return [twice, given];
}"""


def test_a_double_tap_does_not_acknowledge_the_alarm_that_takes_the_place_of_the_first(browser, tmp_path):
    with browser.new_context() as context:
        twice, given = MadeSite(tmp_path).open(context, MIDNIGHT).page.evaluate(TWO_ALARMS)
    assert twice == ["move-failed"]
    assert given == ["move-failed", "driver-hung"]


def shown(browser, folder, remedies, why="x"):
    with browser.new_context() as context:
        return MadeSite(folder).open(context, MIDNIGHT).page.evaluate(SHOWN, [remedies, why])


@pytest.mark.parametrize("tracker", [None, "t7"])
def test_the_remedy_of_an_alarm_names_the_buttons_of_the_page(browser, tmp_path, tracker):
    kinds = ("unexplained-motion", "positioner-fault", "release-changed")
    said = shown(browser, tmp_path, [with_tracker_option(KINDS[kind].remedy, tracker) for kind in kinds])
    moved, *others = said["remedies"]
    assert moved == (
        "What to do: somebody may be at the axes: find out who or what moved them. If the angles of status agree with"
        " the arms: Clear faults; if they do not: Hold, then Clear faults, then Reference run"
    )
    assert others == [
        "What to do: find the cause at the mechanics, then Clear faults, or Reference run if the reference was lost",
        "What to do: run heliocube self-check, look at the tracker, then Auto",
    ]


def test_a_sentence_of_the_service_is_shown_with_the_names_of_buttons_in_place_of_commands(browser, tmp_path):
    why = "a button is pressed: held until 'heliocube auto'; 'heliocube alarms ack x --tracker t7', 'heliocube status'"
    said = shown(browser, tmp_path, [], why)
    assert said["told"] == ["A button is pressed: held until Auto; Acknowledge, 'heliocube status'"] * 3
