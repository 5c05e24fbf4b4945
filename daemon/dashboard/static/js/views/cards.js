// The smaller cards of the view of now: what comes next, wind, light, equipment, and what happened lately.

import { card, fill, h, s, setAttr, setClass, setText } from "../dom.js";
import { at, countdown, counted, deg, duration, localDay, localTime, num, onPage, sentence, signed, signedDeg, utcTime } from "../format.js";

function facts(names) {
  const values = {};
  const list = h("dl", { class: "facts" }, names.map((name) => {
    values[name] = h("dd", null);
    return h("div", null, h("dt", null, name), values[name]);
  }));
  return { list, values };
}

// The law's name stands above already.
const because = ({ law, why }) => (why.startsWith(`${law}: `) ? why.slice(law.length + 2) : why);
const energy = (kwh) => (kwh < 1 ? num(1000 * kwh, kwh < 0.01 ? 2 : 0, "Wh/m²") : num(kwh, 2, "kWh/m²"));
const pair = ({ target_a_deg: a, target_b_deg: b }) => `A ${signedDeg(a)}, B ${deg(b)}`;

function inTheShadow({ law, failed_why, gain, travelled_deg, active_travelled_deg }) {
  if (failed_why !== null) return `${law} has failed and is left out: ${failed_why}`;
  if (gain === null) return `${law}: nothing to compare yet`;
  return `${law} would have received ${num(100 * Math.abs(gain), 1, "%")} ${gain >= 0 ? "more" : "less"} by the model, for ${deg(travelled_deg)} of travel instead of ${deg(active_travelled_deg)}`;
}

export function next() {
  const big = h("p", { class: "big" });
  const { list, values } = facts(["In the present light", "Last decision", "It said", "Moves today", "Travel today", "Received today", "Against chronometric", "Law in the shadow"]);
  const node = card("Next decision", null, big, list);

  function update({ tracker, extra, now, old }) {
    node.hidden = !tracker;
    setClass(node, "stale", old);
    if (!tracker) return;
    const due = tracker.next_decision_s;
    const left = due === null ? null : due - extra;
    // A service of an earlier version does not say.
    const coming = tracker.next_decision ?? null;
    const law = coming?.law ?? tracker.law.name;
    setText(big, due === null ? `None while the mode is ${tracker.mode.name}` : left > 0 ? `in ${countdown(left)}, by ${law}` : `due now, by ${law}`);
    values["In the present light"].parentElement.hidden = coming === null;
    if (coming) setText(values["In the present light"], `${coming.moves ? "would go to" : "would stay; aim"} ${pair(coming)}: ${because(coming)}`);
    const decision = tracker.decision;
    setText(values["Last decision"], decision ? `${at(decision.time, now)}, ${duration(decision.age_s + extra)} ago` : "none yet");
    setText(values["It said"], decision ? `${decision.moved ? "go to" : "stay; aim"} ${pair(decision)}: ${because(decision)}` : "–");
    setText(values["Moves today"], tracker.today ? `${num(tracker.today.moves)} (${num(tracker.today.left.moves)} left)` : "–");
    setText(values["Travel today"], tracker.today ? `${deg(tracker.today.travelled_deg)} (${deg(tracker.today.left.travel_deg)} left)` : "–");
    const shadow = tracker.shadow ?? null;
    values["Law in the shadow"].parentElement.hidden = shadow === null;
    if (shadow) setText(values["Law in the shadow"], inTheShadow(shadow));
    const light = tracker.received ?? null;
    for (const name of ["Received today", "Against chronometric"]) values[name].parentElement.hidden = light === null;
    if (!light) return;
    setText(values["Received today"], `${energy(light.actual_kwh_m2)}, in ${duration(light.known_s)} of light since ${at(light.since, now)}`);
    setText(values["Against chronometric"], `${signed(light.gain === null ? null : 100 * light.gain, 1, "%")}; by the model such a tracker has received ${energy(light.chronometric_kwh_m2)}, the best pose at every instant ${energy(light.best_kwh_m2)}`);
  }

  return { node, update };
}

export function wind() {
  const body = h("div");
  const node = card("Wind", null, body);

  function update({ tracker, extra, old }) {
    node.hidden = !tracker;
    setClass(node, "stale", old);
    if (!tracker) return;
    const sources = tracker.wind;
    setClass(node, "alert", sources.some((source) => source.why));
    fill(body, sources.map(({ name, speed_m_s, stow_from_m_s }) => [name, speed_m_s === null, stow_from_m_s]), () =>
      sources.length ? sources.map(windSource) : h("p", null, "No source of wind: nothing stows this tracker in a storm by itself."));
    sources.forEach((source, index) => showWind(body.children[index], source, extra));
  }

  return { node, update };
}

function windSource({ name, speed_m_s, stow_from_m_s, release_below_m_s }) {
  const most = Math.max(20, (stow_from_m_s ?? 0) * 1.4);
  const x = (value) => (200 * Math.min(value, most)) / most;
  const bar = stow_from_m_s === null ? null : s("svg", { viewBox: "-2 0 204 20", "aria-hidden": "true", class: "windbar" },
    s("rect", { x: 0, y: 5, width: 200, height: 9, rx: 3, class: "track" }),
    s("rect", { x: x(stow_from_m_s), y: 5, width: 200 - x(stow_from_m_s), height: 9, rx: 3, class: "danger" }),
    s("rect", { x: 0, y: 5, width: 0, height: 9, rx: 3, class: "speed" }),
    s("path", { class: "limit", d: `M${x(release_below_m_s)} 2V17M${x(stow_from_m_s)} 2V17` }));
  const { list, values } = facts(["Stows from", "Calm below", "Heard", "Stow"]);
  setText(values["Stows from"], num(stow_from_m_s, 1, "m/s"));
  setText(values["Calm below"], num(release_below_m_s, 1, "m/s"));
  const node = h("div", { class: "source" }, h("p", { class: "big" }), bar, list);
  node.parts = { most, values };
  return node;
}

function showWind(node, source, extra) {
  const { most, values } = node.parts;
  const measured = source.speed_m_s !== null;
  setText(node.querySelector(".big"), `${source.name}: ${measured ? num(source.speed_m_s, 1, "m/s") : source.age_s === null ? "not heard yet" : "no speed"}`);
  const bar = node.querySelector(".speed");
  if (bar) setAttr(bar, "width", measured ? ((200 * Math.min(source.speed_m_s, most)) / most).toFixed(1) : 0);
  setText(values.Heard, source.age_s === null ? "not since the service began" : `${duration(source.age_s + extra)} ago`);
  const ends = source.release_in_s === null ? "" : `; let go in ${countdown(source.release_in_s - extra)} if it stays calm`;
  setText(values.Stow, source.why ? source.why + ends : "not asked for");
}

export function light() {
  const { list, values } = facts(["Beam, normal to the sun", "Diffuse, horizontal", "Albedo of the ground", "Learned albedo", "Learned gains E / S / W", "Power of the module"]);
  const node = card("Light and power", null, list);

  function update({ tracker, extra, old }) {
    setClass(node, "stale", old);
    const decision = tracker?.decision;
    const learned = tracker?.law.learned;
    const curve = tracker?.load?.curve;
    // While nothing is decided, as at night, the last decision tells of light that has gone.
    const believes = decision && decision.dni_est !== null && tracker.next_decision_s !== null;
    node.hidden = !believes && !learned && !tracker?.load;
    if (node.hidden) return;
    const show = (name, text) => {
      setText(values[name], text ?? "");
      values[name].parentElement.hidden = text === null;
    };
    show("Beam, normal to the sun", believes ? num(decision.dni_est, 0, "W/m²") : null);
    show("Diffuse, horizontal", believes ? num(decision.dhi_est, 0, "W/m²") : null);
    show("Albedo of the ground", believes ? num(decision.albedo_est, 2) : null);
    show("Learned albedo", learned ? num(learned.albedo, 2) : null);
    show("Learned gains E / S / W", learned ? [learned.gain_east, learned.gain_south, learned.gain_west].map((gain) => num(gain, 3)).join(" / ") : null);
    show("Power of the module", tracker.load ? (curve?.pmpp_w !== null && curve?.quality === "ok" ? `${num(curve.pmpp_w, 1, "W")}, ${duration(curve.age_s + extra)} ago` : tracker.load.down_why ?? curve?.quality ?? "no curve yet") : null);
  }

  return { node, update };
}

export function equipment() {
  const body = h("tbody");
  const node = card("Equipment", null, h("table", { class: "equipment" }, h("thead", null, h("tr", null, ["Part", "State", "Detail"].map((text) => h("th", { scope: "col" }, text)))), body));

  function update(context) {
    const rows = parts(context).map((row) => (context.old ? { ...row, kind: "off", word: "not known" } : row));
    setClass(node, "stale", context.old);
    fill(body, rows.map(({ name }) => name), () => rows.map(({ name }) => h("tr", null, h("th", { scope: "row" }, name), h("td", null, h("span", { class: "state" })), h("td", null))));
    rows.forEach(({ kind, word, detail }, index) => {
      const [, state, last] = body.children[index].children;
      setText(state.firstChild, word);
      setAttr(state.firstChild, "data-kind", kind);
      setText(last, detail);
    });
  }

  return { node, update };
}

const up = (name, down, detail) => ({ name, kind: down ? "bad" : "ok", word: down ? "down" : "works", detail: down ? sentence(down) : detail });

function parts({ state, tracker, extra }) {
  if (!state) return [];
  const rows = [];
  const unit = tracker?.tracker;
  if (unit) {
    const trouble = [...unit.faults, ...unit.concerns, unit.blocked_why, unit.doubt_why, unit.unexplained_why].filter(Boolean);
    const detail = `${unit.identity ? `${unit.identity.board}, firmware ${unit.identity.firmware}; ` : ""}supply ${num(unit.supply_v, 1, "V")}, motors ${num(unit.motor_current_a.a, 2)} / ${num(unit.motor_current_a.b, 2, "A")}`;
    rows.push(trouble.length && unit.connected ? { name: "Positioner", kind: "bad", word: "fault", detail: sentence([...new Set(trouble)].join("; ")) } : up("Positioner", unit.connected ? null : unit.down_why ?? "does not answer", detail));
  }
  const scan = state.scan;
  const calibration = state.calibration ? `, calibration ${state.calibration.identifier} ${state.calibration.validity}` : "";
  if (state.role !== "tracker") rows.push(up("Cube", state.cube_down_why, `${scan ? `scan ${num(scan.sequence)}` : "no scan yet"}${calibration}`));
  if (state.bridge) {
    const refused = state.bridge.refused;
    const fresh = scan && !scan.stale;
    if (state.bridge.down_why) rows.push(up("Bridge", state.bridge.down_why));
    else rows.push({ name: "Bridge", kind: fresh ? "ok" : "bad", word: fresh ? "works" : "silent", detail: `${counted(state.bridge.accepted, "scan")} accepted, ${num(state.bridge.lost)} lost, ${num(refused)} refused${scan ? `; last ${duration(scan.age_s + extra)} ago` : ""}` });
  }
  if (tracker?.load) rows.push(up("Load", tracker.load.down_why, tracker.load.identity ?? "not open yet"));
  rows.push(state.store ? up("Store", state.store.down_why, `${counted(state.store.written, "record")} written, ${num(state.store.waiting)} wait, ${num(state.store.lost)} lost`) : { name: "Store", kind: "off", word: "off", detail: "no store.directory: records are not kept" });
  const link = tracker ? tracker.mqtt : state.mqtt;
  rows.push(link ? { ...up("Broker", link.connected ? null : link.down_why ?? "no connection", `${link.broker}: ${num(link.sent)} sent, ${num(link.waiting)} wait, ${num(link.dropped)} dropped`), ...(link.connected && link.troubles.length ? { kind: "warn", word: "trouble", detail: link.troubles.join("; ") } : {}) } : { name: "Broker", kind: "off", word: "off", detail: "MQTT is not enabled" });
  return rows;
}

export function log() {
  const body = h("ol", { class: "log" });
  const node = card("What happened lately", null, body);

  function update({ state, tracker, now }) {
    const name = tracker?.tracker.name;
    // With several trackers, the line of one begins with its name, which keeps its spelling.
    const whose = (text) => Object.keys(state.trackers).find((each) => text.startsWith(`${each}: `));
    const own = (state?.news ?? []).filter(({ text }) => !name || [name, undefined].includes(whose(text)));
    const newest = own.slice(-12).reverse();
    const today = state ? localDay(now) : "";
    fill(body, [newest, today], () => newest.length ? newest.map(({ time, text }) => h("li", null, h("time", { datetime: time }, `${localDay(Date.parse(time)) === today ? "" : `${localDay(Date.parse(time))} `}${localTime(Date.parse(time), false)}`, h("span", null, ` ${utcTime(Date.parse(time), false)} UTC`)), h("span", null, onPage(whose(text) ? text : sentence(text), now)))) : h("li", null, h("span", null, "Nothing yet.")));
  }

  return { node, update };
}
