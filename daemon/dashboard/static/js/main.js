// The page: its head, the view that is chosen, and one update a second.

import { fill, h, setAttr, setText } from "./dom.js";
import { localTime, utcDay, utcTime } from "./format.js";
import { elapsed, isOld, Live, serviceNow } from "./live.js";
import { Orders } from "./orders.js";
import { sunOf } from "./sun.js";
import { control } from "./views/control.js";
import { day } from "./views/day.js";
import { fleet } from "./views/fleet.js";
import { now } from "./views/now.js";

const byId = (id) => document.getElementById(id);
const VIEWS = { now, day, fleet, control };
const THEMES = ["auto", "light", "dark"];

const live = new Live(() => requestUpdate());
const orders = new Orders(byId("outcome"), () => requestUpdate());
let chosen = localStorage.getItem("tracker");
let view = null;
let waiting = false;

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
  const entry = trackers.find(({ key }) => key === chosen) ?? trackers[0] ?? { service: { name: "", up: null }, label: "", tracker: null, name: null };
  const { service, tracker } = entry;
  const state = service.state ?? null;
  const time = serviceNow(service);
  return {
    live, orders, trackers, entry, service, tracker, state, now: time, extra: elapsed(service), old: Boolean(state) && isOld(service, live.connected),
    sunDay: sunOf(service, time), several: Object.keys(state?.trackers ?? {}).length > 1,
  };
}

function update() {
  if (document.visibilityState === "hidden") return;
  const found = context();
  head(found);
  view?.update(found);
}

function head({ trackers, entry, service, state, now: time, old }) {
  const picker = byId("tracker");
  picker.parentElement.hidden = trackers.length < 2;
  fill(picker, trackers.map(({ key, label }) => [key, label]), () => trackers.map(({ key, label }) => h("option", { value: key }, label)));
  if (picker.value !== entry.key && entry.key) picker.value = entry.key;
  setText(byId("clock"), state ? `${localTime(time)} local · ${utcTime(time)} UTC${utcDay(time) === utcDay(Date.now()) ? "" : ` · ${utcDay(time)}`}` : "");
  setText(byId("who"), orders.session.by ?? "Log in");
  setAttr(byId("who"), "aria-label", orders.session.by ? `Logged in as ${orders.session.by}: log out` : "Log in");
  byId("stow").disabled = !entry.tracker;
  setAttr(byId("stow"), "aria-label", `Stow ${entry.label}`);
  const banner = byId("banner");
  banner.hidden = live.connected !== false;
  if (live.connected === false) setText(banner, `No connection to the dashboard since ${localTime(live.lostAt)}. What is shown is old. It is tried again by itself.`);
  setAttr(document.body, "data-old", old ? "" : null);
  // Before the first state nothing is known, and nothing is wrong.
  setAttr(document.body, "data-waiting", !state && service.up !== false ? "" : null);
  document.title = state && entry.tracker ? `${old ? "old: " : ""}${entry.tracker.mode.name}, ${entry.label}` : "heliocube";
}

function choose() {
  const wanted = location.hash.slice(1);
  const name = wanted in VIEWS ? wanted : "now";
  view?.close?.();
  view = VIEWS[name](orders);
  byId("view").replaceChildren(view.node);
  for (const link of document.querySelectorAll(".tabs a")) setAttr(link, "aria-current", link.hash === `#${name}` ? "page" : null);
  scrollTo(0, 0);
  update();
}

function pick(key) {
  chosen = key;
  localStorage.setItem("tracker", key);
}

function theme() {
  const root = document.documentElement;
  const current = root.dataset.theme ?? "auto";
  const following = THEMES[(THEMES.indexOf(current) + 1) % THEMES.length];
  if (following === "auto") delete root.dataset.theme;
  else root.dataset.theme = following;
  localStorage.setItem("theme", following);
  showTheme();
}

function showTheme() {
  const current = document.documentElement.dataset.theme ?? "auto";
  setText(byId("theme"), { auto: "◐", light: "☀", dark: "☾" }[current]);
  setAttr(byId("theme"), "aria-label", `Colours: ${current}. Change`);
}

byId("theme").addEventListener("click", theme);
byId("who").addEventListener("click", () => (orders.session.by ? orders.logout() : orders.login(null)));
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
setInterval(update, 1000);
showTheme();
choose();
