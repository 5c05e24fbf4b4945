// The state in one line, the alarms, and who holds what.

import { fill, h, icon, setAttr, setText } from "../dom.js";
import { at, buttonOf, duration, localDay, onPage, sentence } from "../format.js";

// Severity of each mode, for colour; the words say the same.
export const KIND = {
  tracking: "ok", night: "calm", starting: "calm", fallback: "warn", hold: "warn", snow: "warn", maintenance: "warn", stow: "warn", fault: "bad",
};
export const TITLE = {
  tracking: "Tracking", night: "Night", starting: "Starting", fallback: "Fallback: by the clock", hold: "Held", snow: "Snow position", maintenance: "Maintenance", stow: "Stow", fault: "Fault",
};
// In the mode hold a stop is more than a hold: nothing but Auto ends it.
const ASKED = { stop: "Stopped by a person", buttons: "A button was pressed at the unit" };
export const inAWord = (mode) => (mode.asked === "stop" ? "stopped" : mode.name);
const WISH = { maintenance: "Maintenance", stop: "Stopped", buttons: "Button pressed at the unit", stow: "Stow", snow: "Snow position", hold: "Held" };

export function hero(orders) {
  const glyph = h("span", { class: "glyph" });
  const whose = h("p", { class: "whose" });
  const title = h("h1", null);
  const why = h("p", { class: "why" });
  const since = h("p", { class: "since" });
  const simulated = h("p", { class: "simulated", hidden: true }, "SIMULATED", h("span", null));
  const alarms = h("div", { class: "alarms", "aria-live": "polite" });
  const wishes = h("div", { class: "wishes" });
  const node = h("section", { class: "hero", "aria-label": "State" },
    h("div", { class: "mode" }, glyph, h("div", null, h("div", { role: "status" }, whose, title, why), since)), simulated, alarms, wishes);

  function update({ service, state, tracker, entry, now, old }) {
    const name = tracker ? tracker.mode.name : null;
    const kind = !state ? (service?.up === false ? "lost" : "calm") : old ? "lost" : name ? KIND[name] ?? "warn" : state.cube_down_why ? "bad" : "ok";
    setAttr(node, "data-kind", kind);
    const shown = !state ? (service?.up === false ? "lost" : "starting") : old ? "lost" : name ?? (state.cube_down_why ? "fault" : "ok");
    fill(glyph, shown, () => icon(shown));
    setText(whose, entry.label);
    setText(title, headline(service, state, tracker, old));
    setText(why, sentence(onPage(explain(service, state, tracker, old), now)));
    // The mode begins anew at each restart and after each fault; what a person asked for does not.
    const begun = tracker?.wishes[tracker.mode.asked]?.since ?? tracker?.mode.since;
    setText(since, tracker ? `since ${at(begun, now)}, for ${duration((now - Date.parse(begun)) / 1000)}` : "");
    simulated.hidden = !state?.simulated;
    setText(simulated.lastChild, state?.speed > 1 ? ` at ${state.speed} times real speed: nothing is moved` : ": no hardware is moved");
    const own = (state?.alarms ?? []).filter((alarm) => alarm.tracker === null || tracker === null || alarm.tracker === tracker.tracker.name);
    // A time of today has no date; after midnight it needs one.
    const today = state ? localDay(now) : "";
    fill(alarms, [own, entry.key, Boolean(tracker?.wishes.maintenance), today], () => alarmList(own, tracker, now, (alarm) => orders.acknowledge(alarm, entry)));
    fill(wishes, [tracker?.wishes, today], () => wishList(tracker?.wishes ?? {}, now));
  }

  return { node, alarms, update };
}

function headline(service, state, tracker, old) {
  if (!state) return service?.up === false ? "No connection" : "Connecting ...";
  if (old) return "No connection: what is shown is old";
  // "Starting" says too little to a person who has ordered it, or stands at the axes.
  if (tracker?.tracker.homing && tracker.mode.name === "starting") return "Reference run";
  return tracker ? ASKED[tracker.mode.asked] ?? TITLE[tracker.mode.name] ?? sentence(tracker.mode.name) : state.cube_down_why ? "The cube does not answer" : "The cube reads";
}

function explain(service, state, tracker, old) {
  if (!state || old) return service?.why ? `the service at ${service.name} ${service.why}` : "";
  return tracker ? tracker.mode.why : state.cube_down_why ?? "a process of the cube alone: it has no tracker";
}

// Text between backticks is a command: it becomes the name of its button, or stays as it is typed if there is none.
function typed(text) {
  const shown = (command) => (buttonOf(command) ? h("strong", null, buttonOf(command)) : h("code", null, command));
  return text.split("`").map((part, index) => (index % 2 ? shown(part) : part));
}

function alarmState(alarm, now) {
  const since = `since ${at(alarm.since, now)}`;
  if (alarm.state === "cleared") return `${since}; over at ${at(alarm.cleared_at, now)}: it stays here until somebody has seen it`;
  return alarm.acknowledged_by ? `${since}; seen by ${alarm.acknowledged_by}, ${at(alarm.acknowledged_at, now)}` : since;
}

function alarmList(alarms, tracker, now, acknowledge) {
  const muted = tracker?.wishes.maintenance ? [h("p", { class: "hint" }, "Alarms are silent during maintenance.")] : [];
  return [
    ...muted,
    ...alarms.map((alarm) =>
      h("article", { class: "alarm", "data-state": alarm.state, "data-severity": alarm.severity }, icon("fault"),
        h("div", { class: "told" }, h("h2", null, `${alarm.name}: ${alarm.severity}${alarm.state === "raised" ? "" : `, ${alarm.state}`}`), h("p", null, sentence(onPage(alarm.text, now))),
          alarm.remedy ? h("p", null, h("strong", null, "What to do: "), typed(alarm.remedy)) : null, h("p", { class: "hint" }, alarmState(alarm, now))),
        alarm.acknowledged_at ? null : h("button", { type: "button", class: "plain", "aria-label": `Acknowledge ${alarm.name}`, onclick: () => acknowledge(alarm) }, "Acknowledge"))),
  ];
}

export function wishList(wishes, now) {
  return Object.entries(wishes).filter(([, wish]) => wish).map(([name, wish]) => {
    const everybodys = [wish, ...(wish.also ?? [])];
    return h("article", { class: "wish" }, icon(name === "buttons" ? "hold" : name),
      h("div", null, everybodys.map((each, place) =>
        h("p", null, h("strong", null, place ? "Also" : WISH[name] ?? name), each.by ? ` by ${each.by}` : "", each.since ? ` since ${at(each.since, now)}` : "", `: ${onPage(each.why, now)}. `, place === everybodys.length - 1 ? h("em", null, "Ends with Auto.") : null))));
  });
}
