// The page: its head, the view that is chosen, and one update a second.

import { fill, h, setAttr, setText } from "./dom.js";
import { localTime, utcDay, utcTime } from "./format.js";
import { elapsed, isOld, Live, serviceNow } from "./live.js";
import { dropLatePresses, Orders } from "./orders.js";
import { sunOf } from "./sun.js";
import { control } from "./views/control.js";
import { day } from "./views/day.js";
import { fleet } from "./views/fleet.js";
import { inAWord } from "./views/hero.js";
import { now } from "./views/now.js";

const byId = (id) => document.getElementById(id);
const VIEWS = { now, day, fleet, control };
// Orders that are within reach in every view.
const FIRST = { stop: "Stop", stow: "Stow" };
const THEMES = ["auto", "light", "dark"];

let renewed = false;
const live = new Live(() => requestUpdate(), () => { renewed = true; });
const orders = new Orders(byId("outcome"), () => requestUpdate(), () => live.dashboardTime, () => context().now);
dropLatePresses((...said) => orders.say(...said));
// Each tab has its own tracker; a new tab begins with the one that was chosen last in any tab.
let chosen = sessionStorage.getItem("tracker") ?? localStorage.getItem("tracker");
if (chosen !== null) sessionStorage.setItem("tracker", chosen);
let view = null;
let waiting = false;
let lost = { at: null, since: "" };

function requestUpdate() {
  if (waiting) return;
  waiting = true;
  setTimeout(() => {
    waiting = false;
    update();
  }, 0);
}

function context() {
  const trackers = live.trackers;
  // The first tracker is chosen by itself, once, and stays chosen when its service is lost.
  if (chosen === null && trackers[0]?.service.state) pick(trackers[0].key);
  const entry = chosen === null ? trackers[0] ?? { service: { name: "", up: null }, label: "", tracker: null, name: null } : live.entry(chosen, trackers);
  const { service, tracker } = entry;
  const state = service.state ?? null;
  const time = serviceNow(service);
  return {
    live, orders, trackers, entry, service, tracker, state, now: time, extra: elapsed(service), old: Boolean(state) && isOld(service, live.connected),
    sunDay: sunOf(service, time),
  };
}

function update() {
  // Not while an order is under way, whose answer would be lost, nor while somebody types an answer to a question.
  if (renewed && !orders.busy) location.reload();
  const found = context();
  document.title = title(found);
  if (document.visibilityState === "hidden") return;
  head(found);
  view?.update(found);
}

function head({ trackers, entry, service, state, now: time, old }) {
  const picker = byId("tracker");
  // A chosen tracker that its service has not named yet takes the place of the service in the list.
  const choices = trackers.includes(entry) ? trackers : [...trackers.filter((each) => each.key !== service.name || each.service.state), ...(entry.key ? [entry] : [])];
  picker.parentElement.hidden = choices.length < 2;
  fill(picker, choices.map(({ key, label }) => [key, label]), () => choices.map(({ key, label }) => h("option", { value: key }, label)));
  if (picker.value !== entry.key && entry.key) picker.value = entry.key;
  setText(byId("clock"), state ? `${localTime(time)} local · ${utcTime(time)} UTC${utcDay(time) === utcDay(Date.now()) ? "" : ` · ${utcDay(time)}`}` : "");
  setText(byId("who"), orders.session.by ?? "Log in");
  setAttr(byId("who"), "aria-label", orders.session.by ? `Logged in as ${orders.session.by}: log out` : "Log in");
  for (const [name, word] of Object.entries(FIRST)) {
    byId(name).disabled = !entry.tracker;
    setAttr(byId(name), "aria-label", `${word} ${entry.label}`);
    // In the view of all trackers, too, these orders are for one.
    setText(byId(name).querySelector("small"), choices.length < 2 ? "" : entry.label);
  }
  const banner = byId("banner");
  banner.hidden = live.connected !== false;
  if (live.connected === false) setText(banner, `No connection to the dashboard since ${lostSince(state, time)}. What is shown is old. It is tried again by itself.`);
  setAttr(document.body, "data-old", old ? "" : null);
  // Before the first state nothing is known, and nothing is wrong.
  setAttr(document.body, "data-waiting", !state && service.up !== false ? "" : null);
}

// Told by the service's clock, as all other times are: the viewer's own may be wrong. Worked out once for each loss, so
// that a screen reader does not repeat it because a second was rounded the other way.
function lostSince(state, time) {
  if (lost.at !== live.lostAt) lost = { at: live.lostAt, since: localTime(state ? time - (Date.now() - live.lostAt) * (state.speed ?? 1) : live.lostAt) };
  return lost.since;
}

// A tab behind others shows nothing but its title, for hours.
function title({ entry, state, old }) {
  return state && entry.tracker ? `${old ? "old: " : ""}${inAWord(entry.tracker.mode)}, ${entry.label}` : "heliocube";
}

function choose() {
  const wanted = location.hash.slice(1);
  const known = Object.hasOwn(VIEWS, wanted);
  // The link that skips the head leads to the view that is shown.
  if (view && wanted && !known) return;
  const name = known ? wanted : "now";
  view?.close?.();
  view = VIEWS[name](orders);
  byId("view").replaceChildren(view.node);
  for (const link of document.querySelectorAll(".tabs a")) setAttr(link, "aria-current", link.hash === `#${name}` ? "page" : null);
  scrollTo(0, 0);
  update();
}

function pick(key) {
  chosen = key;
  for (const storage of [sessionStorage, localStorage]) storage.setItem("tracker", key);
}

function theme() {
  const root = document.documentElement;
  const current = root.dataset.theme ?? "auto";
  const following = THEMES[(THEMES.indexOf(current) + 1) % THEMES.length];
  if (following === "auto") delete root.dataset.theme;
  else root.dataset.theme = following;
  localStorage.setItem("theme", following);
  showTheme();
  view?.redraw?.();
}

function showTheme() {
  const current = document.documentElement.dataset.theme ?? "auto";
  setText(byId("theme"), { auto: "◐", light: "☀", dark: "☾" }[current]);
  setAttr(byId("theme"), "aria-label", `Colours: ${current}. Change`);
}

byId("theme").addEventListener("click", theme);
byId("who").addEventListener("click", () => (orders.session.by ? orders.logout() : orders.login(null)));
byId("stop").addEventListener("click", () => orders.give("stop", context().entry));
byId("stow").addEventListener("click", () => orders.ask("stow", context().entry));
byId("tracker").addEventListener("change", (event) => {
  pick(event.target.value);
  update();
});
byId("view").addEventListener("click", ({ target }) => {
  if (target.dataset?.key && target.hash === "#now") pick(target.dataset.key);
});
window.addEventListener("hashchange", choose);
document.addEventListener("visibilitychange", update);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view?.redraw?.());
setInterval(update, 1000);
showTheme();
choose();
