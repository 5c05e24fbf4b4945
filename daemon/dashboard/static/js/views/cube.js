// The cube from above, north up: four faces, their light and what the readings are worth.

import { card, h, s, setAttr, setClass, setText } from "../dom.js";
import { duration, num } from "../format.js";

const SCALE = ["#1b0c41", "#3f0f63", "#65156e", "#8a226a", "#ae305c", "#cf4446", "#e8602d", "#f8850f", "#fbb61a", "#f6e75e"];
const FULL_W_M2 = 1000;
const SHAPES = {
  zenith: { d: "M-34-34H34V34H-34Z", at: [0, 0] },
  east: { d: "M34-34L92-92V92L34 34Z", at: [63, 0] },
  west: { d: "M-34-34L-92-92V92L-34 34Z", at: [-63, 0] },
  south: { d: "M-34 34L-92 92H92L34 34Z", at: [0, 66] },
};
// What is wrong with a face, in words.
const WORDS = {
  ok: "good", stale: "too old", missing: "missing", "over-range": "over range", implausible: "implausible", late: "late", "self-test-failed": "self-test failed",
};

export function cube() {
  const faces = {};
  const blank = s("path", { class: "blank", d: "M-34-34L-92-92H92L34-34Z" });
  const group = s("g", null, blank);
  const letters = s("g");
  for (const [name, shape] of Object.entries(SHAPES)) {
    const body = s("path", { d: shape.d, class: "face" });
    const value = s("text", { class: "number" });
    const word = s("text", { class: "word" }, name);
    group.append(body);
    letters.append(value, word);
    faces[name] = { body, value, word, at: shape.at };
  }
  const picture = s("svg", { viewBox: "-96 -96 192 192", role: "img", class: "cube" }, group, letters);
  const table = h("table", null, h("thead", null, h("tr", null, ["Face", "W/m²", "Quality", "Age"].map((text, i) => h("th", { scope: "col", class: i % 2 ? "figure" : null }, text)))));
  const rows = {};
  const body = h("tbody");
  table.append(body);
  for (const name of ["east", "south", "west", "zenith"]) {
    const cells = [h("td", { class: "figure" }), h("td"), h("td", { class: "figure" })];
    const row = h("tr", null, h("th", { scope: "row" }, name), cells);
    rows[name] = { row, cells };
    body.append(row);
  }
  const note = h("p", { class: "age" });
  const node = card("Cube", null, picture, scaleBar(), table, note);

  function update({ state, extra, old }) {
    const scan = state?.scan;
    const mirrored = (state?.site.latitude_deg ?? 0) < 0;
    setAttr(group, "transform", mirrored ? "scale(1 -1)" : null);
    for (const [name, { body: shape, value, word, at: [x, y] }] of Object.entries(faces)) {
      const face = scan?.faces[name];
      const good = face?.quality === "ok" && !old;
      const known = typeof face?.irradiance_w_m2 === "number";
      const place = Math.min(Math.max(Math.floor(((face?.irradiance_w_m2 ?? 0) / FULL_W_M2) * SCALE.length), 0), SCALE.length - 1);
      setAttr(shape, "fill", good && known ? SCALE[place] : null);
      setClass(shape, "unsure", !good);
      const dark = good && known && place < 6;
      const light = good && known && place >= 6;
      for (const text of [value, word]) {
        setClass(text, "on-dark", dark);
        setClass(text, "on-light", light);
        setAttr(text, "x", x);
      }
      const top = mirrored && name === "south" ? -y : y;
      setAttr(value, "y", top + 3);
      setAttr(word, "y", top + 18);
      setText(value, num(face?.irradiance_w_m2));
      setText(word, good || !face ? name : WORDS[face.quality] ?? face.quality);
      const row = rows[name];
      setText(row.cells[0], num(face?.irradiance_w_m2));
      setText(row.cells[1], face ? WORDS[face.quality] ?? face.quality : "no reading");
      setClass(row.row, "bad", Boolean(face) && face.quality !== "ok");
      setText(row.cells[2], face ? duration(face.age_s + extra) : "–");
    }
    const stale = old || !scan || scan.stale;
    setClass(node, "stale", Boolean(stale));
    setText(note, !scan ? "no scan yet" : `${stale ? "STALE: " : ""}scan ${num(scan.sequence)} of ${scan.source}, ${duration(scan.age_s + extra)} old`);
    setAttr(picture, "aria-label", `Irradiance: ${Object.keys(rows).map((name) => `${name} ${rows[name].cells[0].textContent} W/m², ${rows[name].cells[1].textContent}`).join("; ")}`);
  }

  return { node, update };
}

function scaleBar() {
  const width = 100 / SCALE.length;
  const strip = s("svg", { viewBox: "0 0 100 6", preserveAspectRatio: "none", "aria-hidden": "true" }, SCALE.map((colour, i) => s("rect", { x: i * width, y: 0, width: width + 0.2, height: 6, fill: colour })));
  return h("div", { class: "scale" }, h("span", null, "0"), strip, h("span", null, "1000 W/m²"));
}
