// The view of now: everything there is to see of one tracker, on one page.

import { h } from "../dom.js";
import { equipment, light, log, next, wind } from "./cards.js";
import { cube } from "./cube.js";
import { dome } from "./dome.js";
import { hero } from "./hero.js";
import { mount } from "./mount.js";

export function now(orders) {
  const parts = [hero(orders), mount(), dome(), cube(), next(), wind(), light(), equipment(), log()];
  const [top, ...cards] = parts;
  const node = h("div", { class: "now" }, top.node, h("div", { class: "cards" }, cards.map((part) => part.node)));
  return { node, update: (context) => parts.forEach((part) => part.update(context)) };
}
