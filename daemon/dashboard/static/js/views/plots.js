// Plots over a day that share cursor and zoom.

import { h } from "../dom.js";
import { localTime, num, utcTime } from "../format.js";

/* global uPlot */

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Plots {
  constructor(changed) {
    this.key = uPlot.sync("day");
    this.all = [];
    this.changed = changed;
    this.zooming = false;
  }

  // Shows a part of the day in all plots; null is the whole.
  zoom(from, to) {
    this.zooming = true;
    for (const plot of this.all) plot.setScale("x", { min: from, max: to });
    this.zooming = false;
    this.changed(from, to);
  }

  // series: {label, colour, values, dash, steps, scale}; returns an element with the plot and what it says in words.
  add(title, unit, x, series, options = {}) {
    const figure = h("figure", { class: "plot" }, h("figcaption", null, h("strong", null, title), unit ? ` ${unit}` : ""));
    const box = h("div", { class: "canvas", role: "img", "aria-label": words(title, unit, series) });
    figure.append(box);
    const grid = { stroke: css("--line"), width: 1 };
    const font = "12px system-ui, sans-serif";
    const axis = { stroke: css("--muted"), grid, ticks: grid, font };
    const data = [x, ...series.map(({ values }) => values)];
    const config = {
      width: Math.max(200, options.width),
      height: options.height ?? 210,
      cursor: { sync: { key: this.key.key }, drag: { x: true, y: false }, points: { size: 6 } },
      legend: { live: true, show: !options.bare, markers: { width: (_, i) => series[i - 1].width ?? 1.5, dash: (_, i) => lineStyle(series[i - 1]) } },
      scales: { x: { time: true }, y: options.range ? { range: options.range } : {} },
      axes: [
        { ...axis, values: (_, ticks) => ticks.map((tick) => localTime(tick * 1000, false)), space: 64 },
        { ...axis, size: 52, values: options.bare ? () => [] : (_, ticks) => ticks.map((tick) => num(tick, Number.isInteger(tick) ? 0 : 1)) },
      ],
      series: [
        { label: "Time", value: (_, at) => (at === null ? "–" : `${localTime(at * 1000)} local, ${utcTime(at * 1000)} UTC`) },
        ...series.map(({ label, colour, dash, steps, width, digits = 1 }) => ({
          label,
          stroke: colour.startsWith("--") ? css(colour) : colour,
          width: width ?? 1.5,
          dash,
          points: { show: false },
          paths: steps ? uPlot.paths.stepped({ align: 1 }) : undefined,
          // One pixel more: otherwise the edge of the step that a gap leaves out would still be seen.
          ...(steps && { gaps: (_plot, _index, _first, _last, found) => found.map(([from, to]) => [from, to + 1]) }),
          value: (_, value) => num(value, digits),
        })),
      ],
      hooks: {
        setScale: [(plot, scale) => {
          if (scale !== "x" || this.zooming) return;
          this.zooming = true;
          const { min, max } = plot.scales.x;
          for (const other of this.all) if (other !== plot) other.setScale("x", { min, max });
          this.zooming = false;
          this.changed(min, max);
        }],
        draw: options.draw ? [options.draw] : [],
      },
    };
    const plot = new uPlot(config, data, box);
    plot.box = box;
    this.all.push(plot);
    return figure;
  }

  resize(width) {
    for (const plot of this.all) plot.setSize({ width: Math.max(200, width), height: plot.height });
  }

  clear() {
    for (const plot of this.all) {
      this.key.unsub(plot);
      plot.destroy();
    }
    this.all = [];
  }
}

// What CSS calls the line of a series.
function lineStyle({ dash }) {
  if (!dash) return "solid";
  return dash[0] > dash[1] ? "dashed" : "dotted";
}

function words(title, unit, series) {
  const parts = series.map(({ label, values, digits = 1 }) => {
    let low = Infinity;
    let high = -Infinity;
    for (const value of values) {
      if (value === null || value === undefined) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    return high < low ? `${label}: nothing` : `${label} from ${num(low, digits)} to ${num(high, digits)}`;
  });
  return `${title} ${unit}: ${parts.join("; ") || "see the list below"}`;
}
