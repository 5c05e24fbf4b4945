// All trackers at once: who is where, who is not where the others are, and stop and stow for all.

import { card, fill, h, icon, setAttr, setText } from "../dom.js";
import { at, deg, duration, num, onPage, sentence, signedDeg } from "../format.js";
import { normal, separationDeg } from "../geometry.js";
import { elapsed, isOld, serviceNow } from "../live.js";
import { target } from "./dome.js";
import { inAWord, KIND } from "./hero.js";

const HEADS = ["Tracker", "Mode", "A actual / set", "B actual / set", "Off its set point", "Set point off the median", "Wind", "Age", "Alarms", "Order"];
// From here on, independent monitors count a tracker as not available.
const FAR_DEG = 5;
const DOWN = ", cube down";
const ABOUT = { stop: "every tracker, at once; only Auto ends it", stow: "every tracker of every service" };

// What came of the last order to all, and when a stow was given: both are still there when the view is opened again.
const results = h("ul", { class: "results" });
let ordered = null;

export function fleet(orders) {
  const title = h("h1", null);
  const tally = h("p", { class: "why" });
  const progress = h("span", { role: "status" });
  // It changes every second, so no screen reader shall read it out.
  const since = h("span");
  const all = ["stop", "stow"].map((name) => h("button", { type: "button", class: `order ${name}`, onclick: () => giveAll(name) }, icon(name), h("span", null, h("strong", null, `${sentence(name)} all`), h("small", null, ABOUT[name]))));
  const body = h("tbody");
  const table = h("table", { class: "fleet" }, h("thead", null, h("tr", null, HEADS.map((text) => h("th", { scope: "col" }, text)))), body);
  const node = h("div", { class: "whole" },
    h("section", { class: "hero", "aria-label": "State of the fleet" }, title, tally, h("p", { class: "moving" }, progress, since)),
    h("section", { class: "orders", "aria-label": "Orders to all" }, all), results,
    card("Trackers", { class: "wide" }, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Trackers, one a row" }, table)));
  let known = new Map();
  let entries = new Map();
  // Trackers are released one by one, as somebody may be at any of them.
  const release = (key, label) => h("td", { class: "release" }, h("button", { type: "button", class: "plain", "aria-label": `Auto ${label}`, onclick: () => orders.ask("auto", entries.get(key)) }, "Auto"));

  async function giveAll(name) {
    const found = await orders.giveAll(name);
    if (!found) return;
    const time = orders.now();
    ordered = name === "stow" ? performance.now() : null;
    const given = h("li", { class: "hint" }, `${sentence(name)} all, ${at(Number.isFinite(time) ? new Date(time).toISOString() : null)}`);
    results.replaceChildren(given, ...found.map(({ service, accepted, text }) => h("li", { class: accepted ? null : "problem" }, `${service}: ${accepted || text.startsWith("NOT done") ? "" : "NOT DONE: "}${onPage(text, serviceNow(known.get(service) ?? {}))}`)));
  }

  function update({ trackers, live }) {
    known = live.services;
    entries = new Map(trackers.map((entry) => [entry.key, entry]));
    const rows = trackers.map((entry) => row(entry, live.connected));
    compare(rows);
    const own = rows.filter(({ tracker }) => tracker);
    // Nobody knows how many trackers a service has that has never answered.
    const gone = rows.filter(({ kind, tracker }) => kind === "lost" && !tracker).length;
    const silent = gone === 1 ? "1 service does not answer" : `${gone} services do not answer`;
    const waiting = rows.every(({ state, up }) => !state && up !== false);
    const troubled = rows.filter(({ kind, cube, alarms }) => kind === "bad" || kind === "lost" || cube === DOWN || alarms.some(unseen)).length;
    setText(title, waiting ? "Connecting ..." : !own.length && gone ? (gone === 1 ? "The service does not answer" : silent) : `${own.length} tracker${own.length === 1 ? "" : "s"}: ${troubled ? `${troubled} need${troubled === 1 ? "s" : ""} attention` : "none needs attention"}`);
    setAttr(node.firstChild, "data-kind", waiting ? "calm" : troubled ? "bad" : own.some(({ kind }) => kind === "warn") ? "warn" : "ok");
    const counts = {};
    for (const { mode } of own) counts[mode] = (counts[mode] ?? 0) + 1;
    const counted = Object.entries(counts).sort((a, b) => b[1] - a[1]).map(([mode, count]) => `${count} ${mode}`);
    setText(tally, [...counted, ...(own.length && gone ? [silent] : [])].join(", "));
    const stowed = own.filter(({ mode, tracker }) => mode === "stow" && tracker.at_stow).length;
    const done = stowed === own.length && !gone;
    if (ordered !== null && done) ordered = Infinity;
    const underWay = ordered !== null && ordered !== Infinity;
    setText(progress, underWay ? `${stowed} of ${own.length} stand stowed${gone ? `, ${silent}` : ""}` : ordered && done ? `All ${own.length} stand stowed.` : "");
    setText(since, underWay ? `, ${duration((performance.now() - ordered) / 1000)} after the order` : "");
    for (const button of all) button.disabled = own.length === 0;
    fill(body, rows.map(({ key, label }) => [key, label]), () => rows.map(({ key, label }) => h("tr", null, h("th", { scope: "row" }, h("a", { href: "#now", "data-key": key }, label)), HEADS.slice(1, -1).map((name) => h("td", { "data-name": name })), release(key, label))));
    rows.forEach((each, index) => show(body.children[index], each));
  }

  return { node, update };
}

// Somebody looks after an acknowledged alarm, and a notice can wait.
const unseen = ({ state, severity }) => state !== "acknowledged" && severity !== "notice";

// What is the matter with the cube: a tracker that is stopped, held or stowed does not say so in its mode.
function cubeOf({ cube_down_why, bridge, scan }) {
  if (cube_down_why) return DOWN;
  if (bridge?.down_why) return ", bridge down";
  return bridge && scan?.stale ? ", cube silent" : "";
}

function row({ key, label, service, tracker }, connected) {
  const state = service.state;
  const extra = elapsed(service);
  const old = Boolean(state) && isOld(service, connected);
  const mode = !state && service.up !== false ? "connecting" : old || !state ? "no connection" : tracker ? inAWord(tracker.mode) : state.cube_down_why ? "cube down" : "cube reads";
  const kind = !state && service.up !== false ? "calm" : old || !state ? "lost" : tracker ? KIND[tracker.mode.name] ?? "warn" : state.cube_down_why ? "bad" : "ok";
  const pose = tracker?.tracker.pose;
  const wanted = target(tracker);
  const latitude = state?.site.latitude_deg ?? 0;
  const direction = wanted ? normal(wanted.a_deg, wanted.b_deg, latitude) : null;
  const off = pose && direction ? separationDeg(normal(pose.a_deg, pose.b_deg, latitude), direction) : null;
  const alarms = (state?.alarms ?? []).filter((alarm) => alarm.tracker === null || !tracker || alarm.tracker === tracker.tracker.name);
  const cube = tracker && !old ? cubeOf(state) : "";
  return { key, label, state, up: service.up, tracker, old, mode, kind, cube, pose, wanted, off, alarms, extra, why: tracker && onPage(tracker.mode.why, serviceNow(service)), group: tracker ? `${state.site.name}/${tracker.law.name}` : null, stale: old || !pose || pose.stale };
}

// Compares set points with the median of the same site and law, if there are three or more.
function compare(rows) {
  const groups = new Map();
  for (const each of rows) if (each.wanted && !each.old) groups.set(each.group, [...(groups.get(each.group) ?? []), each]);
  for (const members of groups.values()) {
    if (members.length < 3) continue;
    const [a, b] = ["a_deg", "b_deg"].map((name) => median(members.map(({ wanted }) => wanted[name])));
    for (const each of members) each.astray = separationDeg(normal(each.wanted.a_deg, each.wanted.b_deg, 1), normal(a, b, 1));
  }
}

function median(values) {
  const sorted = [...values].sort((x, y) => x - y);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}

const worse = (value, moving) => (value === null || value === undefined ? null : value >= FAR_DEG && !moving ? "bad" : value >= 1 && !moving ? "warn" : "ok");

function show(line, each) {
  const [, mode, a, b, off, astray, wind, age, alarms, release] = line.children;
  release.firstChild.hidden = !Object.values(each.tracker?.wishes ?? {}).some(Boolean);
  const moving = each.tracker?.tracker.moving;
  setAttr(line, "data-kind", each.kind);
  setText(mode, `${each.mode}${each.cube}`);
  setAttr(mode, "title", each.why ?? null);
  setText(a, each.tracker ? `${signedDeg(each.pose?.a_deg)} / ${signedDeg(each.wanted?.a_deg)}` : "–");
  setText(b, each.tracker ? `${deg(each.pose?.b_deg)} / ${deg(each.wanted?.b_deg)}` : "–");
  setText(off, each.off === null ? "–" : `${deg(each.off)}${moving ? ", moving" : ""}`);
  setAttr(off, "data-off", worse(each.off, moving));
  setText(astray, each.astray === undefined ? "–" : deg(each.astray));
  setAttr(astray, "data-off", worse(each.astray, false));
  const gusts = each.tracker?.wind ?? [];
  setText(wind, gusts.length ? gusts.map(({ speed_m_s, why }) => `${num(speed_m_s, 1, "m/s")}${why ? ", stows" : ""}`).join("; ") : "–");
  setText(age, each.pose ? `${each.stale ? "STALE " : ""}${duration(each.pose.age_s + each.extra)}` : each.state?.scan && !each.tracker ? duration(each.state.scan.age_s + each.extra) : "–");
  setAttr(age, "data-off", each.stale && each.tracker ? "bad" : null);
  setText(alarms, each.alarms.length ? each.alarms.map(({ name }) => name).join(", ") : each.state && !each.old ? "none" : "–");
  setAttr(alarms, "data-off", each.alarms.length ? "bad" : null);
}
