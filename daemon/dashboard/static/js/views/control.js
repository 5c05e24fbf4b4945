// The operator's commands to one tracker, with what its telemetry shows of them.

import { card, fill, h, icon, setClass, setText } from "../dom.js";
import { BUTTONS, deg, duration, num, signedDeg } from "../format.js";
import { hero } from "./hero.js";

const ASKED = ["stow", "auto", "snow", "maintenance", "home", "clear", "relearn"];
const ABOUT = {
  stop: "stops at once; only Auto ends it",
  hold: "stays where it is",
  auto: "the service decides again",
  stow: "to the stow position, whatever else is wanted",
  snow: "steep, to shed snow and hail",
  maintenance: "nothing moves, alarms silent",
  home: "both axes over their whole range",
  clear: "forgives what is shown",
  relearn: "forgets albedo and gains",
};

export function control(orders) {
  let entry = null;
  const state = hero(orders);
  const order = (name) => () => entry && (ASKED.includes(name) ? orders.ask(name, entry) : orders.give(name, entry));
  const button = (name) => h("button", { type: "button", class: `order ${name}`, onclick: order(name) }, icon(name), h("span", null, h("strong", null, BUTTONS[name]), h("small", null, ABOUT[name])));
  const input = (name) => h("input", { name, type: "number", step: "any", required: true, inputmode: "text" });
  const a = input("a_deg");
  const b = input("b_deg");
  const ranges = [h("span", { class: "hint" }), h("span", { class: "hint" })];
  const form = h("form", { class: "goto" },
    h("label", null, h("span", null, "A, east negative ", ranges[0]), a), h("label", null, h("span", null, "B, flat is 90° ", ranges[1]), b),
    h("button", { type: "submit", class: "strong" }, "Go there and hold"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (entry && form.reportValidity()) orders.give("goto", entry, { a_deg: a.valueAsNumber, b_deg: b.valueAsNumber });
  });
  const effect = h("p", { class: "big" });
  const detail = h("p", { class: "hint" });
  const seen = card("What telemetry shows", null, effect, detail);
  const login = h("p", { class: "hint" });
  const node = h("div", { class: "control" },
    state.node,
    h("section", { class: "orders", "aria-label": "Orders" }, ["stow", "stop", "hold", "auto"].map(button)),
    seen,
    // Below the orders: above, alarms would push the orders off a phone's screen.
    state.alarms,
    card("Go to a position", null, form),
    h("section", { class: "orders small", "aria-label": "Further orders" }, ["snow", "maintenance", "home", "clear", "relearn"].map(button)),
    login);

  function update(context) {
    entry = context.entry;
    state.update(context);
    const { tracker, extra, old } = context;
    for (const control of node.querySelectorAll(".order, .goto button")) control.disabled = !tracker;
    const unit = tracker?.tracker;
    if (unit) {
      const { a_min_deg, a_max_deg, b_min_deg, b_max_deg } = unit.limits;
      [[a, a_min_deg, a_max_deg, ranges[0]], [b, b_min_deg, b_max_deg, ranges[1]]].forEach(([field, min, max, range]) => {
        field.min = min;
        field.max = max;
        setText(range, `${num(min)} to ${num(max)}°`);
      });
    }
    setText(effect, context.state && !old ? shown(unit) : "Not known");
    setText(detail, !unit?.pose ? "" : `${old || unit.pose.stale ? "STALE: " : ""}A ${signedDeg(unit.pose.a_deg)}, B ${deg(unit.pose.b_deg)}, ${duration(unit.pose.age_s + extra)} old`);
    setClass(seen, "stale", Boolean(old || !unit?.pose || unit.pose.stale));
    fill(login, [orders.session], () => orders.session.by ? `Orders are noted as from ${orders.session.by}.` : "The first order asks for the service's token, once.");
  }

  return { node, update };
}

function shown(unit) {
  if (!unit) return "There is no tracker here";
  if (!unit.connected) return "The positioner does not answer";
  if (unit.homing) return "Reference run: both axes move";
  if (!unit.target) return "Both axes stand still";
  return `Moving to A ${signedDeg(unit.target.a_deg)}, B ${deg(unit.target.b_deg)}`;
}
