// The sky seen from above, north up: the sun and its path, where the module can point, and where it does.

import { card, h, s, setAttr, setText } from "../dom.js";
import { deg } from "../format.js";
import { azimuthElevation, direction, normal, separationDeg, sunAt } from "../geometry.js";

const R = 100;

// Azimuth and elevation to a place in the circle; below the horizon is outside.
function place(azimuth, elevation) {
  const r = ((90 - elevation) / 90) * R;
  const angle = (azimuth * Math.PI) / 180;
  return [r * Math.sin(angle), -r * Math.cos(angle)];
}

const path = (points) => points.map(([x, y], index) => `${index ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

function zone({ a_min_deg, a_max_deg, b_min_deg, b_max_deg }, latitude) {
  const edge = [];
  const steps = 24;
  const between = (from, to, share) => from + (to - from) * share;
  for (let i = 0; i < steps; i += 1) edge.push([between(a_min_deg, a_max_deg, i / steps), b_min_deg]);
  for (let i = 0; i < steps; i += 1) edge.push([a_max_deg, between(b_min_deg, b_max_deg, i / steps)]);
  for (let i = 0; i < steps; i += 1) edge.push([between(a_max_deg, a_min_deg, i / steps), b_max_deg]);
  for (let i = 0; i < steps; i += 1) edge.push([a_min_deg, between(b_max_deg, b_min_deg, i / steps)]);
  return `${path(edge.map(([a, b]) => {
    const { azimuth, elevation } = azimuthElevation(normal(a, b, latitude));
    return place(azimuth, elevation);
  }))}Z`;
}

export function dome() {
  const reach = s("path", { class: "zone" });
  const track = s("path", { class: "sunpath" });
  const hours = s("g", { class: "hours" });
  const sun = s("g", { class: "sun" }, s("circle", { r: 7 }));
  const set = s("g", { class: "set" }, s("circle", { r: 9 }), s("circle", { r: 1.6, class: "dot" }));
  const actual = s("g", { class: "actual" }, s("path", { d: "M-12 0H12M0-12V12" }), s("circle", { r: 5 }));
  const rings = [30, 60].map((elevation) => s("circle", { r: ((90 - elevation) / 90) * R, class: "ring" }));
  const names = [["N", 0, -R - 6], ["E", R + 8, 4], ["S", 0, R + 14], ["W", -R - 8, 4]];
  const picture = s("svg", { viewBox: "-118 -118 236 240", role: "img", class: "dome" },
    s("circle", { r: R, class: "sky" }), reach, rings, s("path", { class: "ring", d: `M${-R} 0H${R}M0${-R}V${R}` }),
    s("text", { x: 3, y: -32, class: "small" }, "60°"), s("text", { x: 3, y: -65, class: "small" }, "30°"),
    names.map(([text, x, y]) => s("text", { x, y, class: "compass" }, text)), track, hours, sun, set, actual);
  const facts = h("dl", { class: "facts" });
  const rows = Object.fromEntries(["Sun", "Module", "Off the sun"].map((name) => {
    const value = h("dd", null);
    facts.append(h("div", null, h("dt", null, name), value));
    return [name, value];
  }));
  const node = card("Sky", null, picture, legend(), facts);
  let shown = null;

  function update({ state, tracker, sunDay, now, old }) {
    node.classList.toggle("stale", Boolean(old || (tracker && (!tracker.tracker.pose || tracker.tracker.pose.stale))));
    const latitude = state?.site.latitude_deg ?? 0;
    const there = sunAt(sunDay?.path, now);
    const limits = tracker?.tracker.limits;
    if (limits) setAttr(reach, "d", zone(limits, latitude));
    if (sunDay && shown !== sunDay) {
      shown = sunDay;
      const above = sunDay.path.filter((point) => point.elevation_deg > 0);
      setAttr(track, "d", path(above.map((point) => place(point.azimuth_deg, point.elevation_deg))));
      hours.replaceChildren(...marks(above));
    }
    put(sun, there && there.elevation > 0 ? place(there.azimuth, there.elevation) : null);
    const pose = tracker?.tracker.pose;
    const standing = pose ? normal(pose.a_deg, pose.b_deg, latitude) : null;
    const wanted = target(tracker);
    const real = standing ? azimuthElevation(standing) : null;
    put(actual, real ? place(real.azimuth, real.elevation) : null);
    const goal = wanted ? azimuthElevation(normal(wanted.a_deg, wanted.b_deg, latitude)) : null;
    put(set, goal ? place(goal.azimuth, goal.elevation) : null);
    setText(rows.Sun, there ? `azimuth ${deg(there.azimuth, 0)}, elevation ${deg(state.sun_elevation_deg)}` : `elevation ${deg(state?.sun_elevation_deg)}`);
    setText(rows.Module, real ? `azimuth ${tilted(real) ? deg(real.azimuth, 0) : "any"}, tilt ${deg(90 - real.elevation)}` : "not known");
    const apart = standing && there ? separationDeg(standing, direction(there.azimuth, there.elevation)) : null;
    setText(rows["Off the sun"], apart === null ? "not known" : there.elevation < 0 ? "the sun is down" : deg(apart));
    setAttr(picture, "aria-label", `Sky: sun at ${rows.Sun.textContent}; module at ${rows.Module.textContent}; ${rows["Off the sun"].textContent} off the sun`);
  }

  return { node, update };
}

const tilted = (where) => where.elevation < 89.5;

// Where the tracker is heading, or what the last decision was.
export function target(tracker) {
  if (!tracker) return null;
  if (tracker.tracker.target) return tracker.tracker.target;
  const decision = tracker.decision;
  const decides = tracker.mode.name === "tracking" || tracker.mode.name === "fallback";
  return decides && typeof decision?.target_a_deg === "number" ? { a_deg: decision.target_a_deg, b_deg: decision.target_b_deg } : null;
}

function put(node, where) {
  setAttr(node, "visibility", where ? null : "hidden");
  if (where) setAttr(node, "transform", `translate(${where[0].toFixed(1)} ${where[1].toFixed(1)})`);
}

function marks(points) {
  return points.filter((point) => new Date(point.time).getUTCHours() % 2 === 0).filter((point, index, all) => index === 0 || new Date(all[index - 1].time).getUTCHours() !== new Date(point.time).getUTCHours()).map((point) => {
    const [x, y] = place(point.azimuth_deg, point.elevation_deg);
    return s("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: 1.8 });
  });
}

function legend() {
  const item = (kind, shape, text) => h("span", { class: "item" }, s("svg", { viewBox: "-12 -12 24 24", "aria-hidden": "true", class: "key" }, s("g", { class: kind }, shape)), text);
  return h("p", { class: "legend" },
    item("sun", s("circle", { r: 7 }), "sun and path"),
    item("set", s("circle", { r: 8 }), "set"),
    item("actual", [s("path", { d: "M-11 0H11M0-11V11" }), s("circle", { r: 4.5 })], "actual"),
    item("zone", s("rect", { x: -10, y: -7, width: 20, height: 14 }), "within reach"));
}
