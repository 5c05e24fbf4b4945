// The tracker drawn as it stands, seen from the south-east, and its two angles, set against actual, within the limits.

import { card, h, s, setAttr, setClass, setText } from "../dom.js";
import { deg, duration, signedDeg } from "../format.js";
import { cross, direction, dot, edge, normal, sunAt } from "../geometry.js";
import { target } from "./dome.js";

const CAMERA = direction(145, 22);
const RIGHT = [Math.cos((145 * Math.PI) / 180) * -1, Math.sin((145 * Math.PI) / 180), 0];
const UP = cross(CAMERA, RIGHT);
const CENTRE = [0, 0, 62];
const WIDE = 52;
const HIGH = 34;

const seen = (point) => [dot(point, RIGHT), -dot(point, UP)];
const add = (...vectors) => [0, 1, 2].map((i) => vectors.reduce((sum, v) => sum + v[i], 0));
const times = (v, factor) => v.map((value) => value * factor);
const line = (points, closed = true) => `${points.map((p, i) => `${i ? "L" : "M"}${seen(p).map((v) => v.toFixed(1)).join(" ")}`).join("")}${closed ? "Z" : ""}`;

function panel(aDeg, bDeg, latitude) {
  const facing = normal(aDeg, bDeg, latitude);
  const across = edge(aDeg, bDeg, latitude);
  const along = cross(facing, across);
  const at = (x, y) => add(CENTRE, times(across, x * WIDE), times(along, y * HIGH));
  const cells = [];
  for (let i = 1; i < 6; i += 1) cells.push(line([at(-1 + i / 3, -1), at(-1 + i / 3, 1)], false));
  for (let j = 1; j < 4; j += 1) cells.push(line([at(-1, -1 + j / 2), at(1, -1 + j / 2)], false));
  return { facing, outline: line([at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)]), cells: cells.join("") };
}

export function mount() {
  const ghost = s("path", { class: "ghost" });
  const body = s("path", { class: "panel" });
  const cells = s("path", { class: "cells" });
  const ray = s("path", { class: "ray" });
  const ball = s("circle", { r: 8, class: "ball" });
  const points = [["E", 96, 0], ["S", 0, -96], ["N", 0, 96], ["W", -96, 0]];
  const ground = s("g", { class: "ground" }, s("ellipse", { rx: 84, ry: 84 * CAMERA[2] }),
    points.map(([name, east, north]) => {
      const [x, y] = seen([east, north, 0]);
      return s("text", { x: x.toFixed(1), y: (y + 4).toFixed(1), class: "compass" }, name);
    }));
  const picture = s("svg", { viewBox: "-112 -144 224 192", role: "img", class: "mount" },
    ground, s("path", { class: "post", d: `${line([[0, 0, 0], CENTRE], false)}` }), ghost, body, cells, ray, ball);
  const a = gauge("A", "east", "west");
  const b = gauge("B", "tilted", "flat");
  const status = h("p", { class: "moving" });
  const age = h("p", { class: "age" });
  const node = card("Tracker", null, picture, h("div", { class: "gauges" }, a.node, b.node), status, age);

  function update({ state, tracker, sunDay, now, extra, old }) {
    // A cube's process has no tracker; before its first state nobody knows.
    node.hidden = Boolean(state) && !tracker;
    const unit = tracker?.tracker;
    const pose = unit?.pose;
    const latitude = state?.site.latitude_deg ?? 0;
    const wanted = target(tracker);
    if (pose) {
      const now3d = panel(pose.a_deg, pose.b_deg, latitude);
      setAttr(body, "d", now3d.outline);
      setAttr(cells, "d", now3d.cells);
      setClass(body, "back", dot(now3d.facing, CAMERA) < 0);
    }
    setAttr(ghost, "d", wanted ? panel(wanted.a_deg, wanted.b_deg, latitude).outline : null);
    const sun = sunAt(sunDay?.path, now);
    const up = sun && sun.elevation > 0;
    const far = up ? add(CENTRE, times(direction(sun.azimuth, sun.elevation), 84)) : null;
    for (const part of [ray, ball]) setAttr(part, "visibility", up ? null : "hidden");
    if (up) {
      setAttr(ray, "d", line([far, add(CENTRE, times(direction(sun.azimuth, sun.elevation), 6))], false));
      const [x, y] = seen(far);
      setAttr(ball, "transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    }
    const stale = old || !pose || pose.stale;
    setClass(node, "stale", Boolean(stale));
    a.update(pose?.a_deg, wanted?.a_deg, unit?.limits.a_min_deg, unit?.limits.a_max_deg);
    b.update(pose?.b_deg, wanted?.b_deg, unit?.limits.b_min_deg, unit?.limits.b_max_deg);
    // A move goes on without its host: while the positioner is silent, nobody knows whether the axes move.
    const known = unit && !old && unit.connected !== false;
    setText(status, !unit ? "" : !known ? "Not known whether the axes move" : unit.homing ? "Reference run: both axes move" : unit.moving ? `Moving to A ${signedDeg(wanted?.a_deg)}, B ${deg(wanted?.b_deg)}: ${unit.target.why}` : "Standing still");
    setClass(status, "on", Boolean(known && (unit.moving || unit.homing)));
    setText(age, pose ? `${stale ? "STALE: " : ""}telemetry ${duration(pose.age_s + extra)} old` : "no telemetry");
    setAttr(picture, "aria-label", pose ? `The tracker ${stale ? "was last seen" : "stands"} at A ${signedDeg(pose.a_deg)}, B ${deg(pose.b_deg)}` : "Where the tracker stands is not known");
  }

  return { node, update };
}

function gauge(name, low, high) {
  const value = h("strong", { class: "value" });
  const wanted = h("span", { class: "wanted" });
  const track = s("rect", { x: 0, y: 8, width: 200, height: 6, rx: 3, class: "track" });
  const set = s("path", { class: "setmark", d: "M0 2V20" });
  const actual = s("path", { class: "actualmark", d: "M0 14l-6 9h12z" });
  const ends = [h("span"), h("span")];
  const picture = s("svg", { viewBox: "-8 0 216 26", "aria-hidden": "true" }, track, set, actual);
  const node = h("div", { class: "gauge" }, h("p", null, h("span", { class: "axis" }, name), value, wanted), picture, h("p", { class: "ends" }, ends));

  function update(is, shall, min, max) {
    setText(value, signed(name, is));
    const off = typeof is === "number" && typeof shall === "number" ? is - shall : null;
    setText(wanted, shall === undefined || shall === null ? "no set point" : `set ${signed(name, shall)}, off by ${deg(off === null ? NaN : Math.abs(off))}`);
    const x = (v) => (200 * (Math.min(Math.max(v, min), max) - min)) / (max - min);
    setAttr(actual, "visibility", typeof is === "number" ? null : "hidden");
    setAttr(set, "visibility", typeof shall === "number" ? null : "hidden");
    if (typeof is === "number") setAttr(actual, "transform", `translate(${x(is).toFixed(1)} 0)`);
    if (typeof shall === "number") setAttr(set, "transform", `translate(${x(shall).toFixed(1)} 0)`);
    setText(ends[0], min === undefined ? "" : `${signed(name, min, 0)} ${low}`);
    setText(ends[1], max === undefined ? "" : `${signed(name, max, 0)} ${high}`);
  }

  return { node, update };
}

const signed = (name, value, digits = 1) => (name === "A" ? signedDeg(value, digits) : deg(value, digits));
