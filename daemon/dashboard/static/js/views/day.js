// Today, and any day that the store has: light, angles against the sun's path, modes, moves and events.

import { fill, h, setAttr, setText } from "../dom.js";
import { counted, deg, duration, localTime, num, onPage, sentence, utcTime } from "../format.js";
import { direction } from "../geometry.js";
import { dateOf, DAY_MS, giveUp, lines, numbers, solarDay, startOf, storedDays, withPauses } from "../history.js";
import { KIND, TITLE } from "./hero.js";
import { Plots } from "./plots.js";

const FRESH_MS = 30000;
// Late in a day the times of numbers are off by up to 4 ms, because they come in 32 bits.
const PAST_MS = 5;
const AGAIN_MS = 10000;
// More lines take a person and a browser long; they are there on request.
const FEW_LINES = 200;
// uPlot's mode of `join` in which a null covers the times of other series up to the next value.
const EXPAND = 2;
// What counts as a pause, as in the report: a minute without scans or curves, a quarter of an hour without others.
const SHORT_PAUSE_S = 60;
const LONG_PAUSE_S = 900;
// The lines differ without their colours too: solid, dashed, dotted and bold.
const FACES = [["east", "#0084c8"], ["south", "#d98200", { dash: [7, 3] }], ["west", "#00926b", { dash: [2, 3] }], ["zenith", "--ink", { width: 2.5 }]];
const SHADES = { ok: "--ok", calm: "--track", warn: "--sun", bad: "--bad" };
const KINDS_OF_NUMBERS = ["scans", "poses", "decisions", "curves"];
const KINDS_OF_LINES = ["modes", "moves", "events"];
const KINDS = [...KINDS_OF_NUMBERS, ...KINDS_OF_LINES];

export function day() {
  const picker = h("select", { "aria-label": "Day" });
  const step = (by) => () => {
    const index = picker.selectedIndex - by;
    if (index >= 0 && index < picker.options.length) {
      picker.selectedIndex = index;
      pick();
    }
  };
  const shown = h("p", { class: "hint", role: "status" });
  const summary = h("p", { class: "summary" });
  const figures = h("div", { class: "plots" });
  const happened = h("ol", { class: "log" });
  const more = h("button", { type: "button", class: "plain", hidden: true, onclick: () => list(Infinity) });
  const zoom = (part) => h("button", { type: "button", class: "plain", onclick: () => show(part) }, part);
  const node = h("div", { class: "day" },
    h("section", { class: "card wide", "aria-label": "Which day" },
      h("div", { class: "choices start" }, h("button", { type: "button", class: "plain", "aria-label": "Day before", onclick: step(-1) }, "←"), h("label", { class: "pick" }, h("span", { class: "sr" }, "Day"), picker), h("button", { type: "button", class: "plain", "aria-label": "Day after", onclick: step(1) }, "→"), zoom("Whole day"), zoom("Daylight"), zoom("Last hour")),
      h("h1", { class: "sr" }, "A day"), summary, shown),
    h("section", { class: "card wide", "aria-label": "Plots" }, figures),
    h("section", { class: "card wide", "aria-label": "What happened" }, h("h2", null, "What happened"), happened, more));
  const plots = new Plots((from, to) => setText(shown, from ? `Shown: ${held && to - from >= (held.to - held.from) / 1000 - 1 ? "the whole solar day, " : ""}${localTime(from * 1000)} to ${localTime(to * 1000)} local time (${utcTime(from * 1000)} to ${utcTime(to * 1000)} UTC). Drag across a plot to zoom, double-click for the whole day.` : ""));
  let source = null;
  let context = null;
  let days = [];
  let newest = null;
  let picked = null;
  let held = null;
  let asked = 0;
  let asking = false;
  let loading = false;
  let wish = null;

  // Asks which days there are, and shows the newest, also when a new day begins, unless another one was picked.
  async function choose() {
    const { service, entry, state, now } = context;
    if (source !== entry.key) {
      source = entry.key;
      picked = null;
      clear();
    }
    asking = true;
    if (!held) setText(shown, "Loading ...");
    try {
      const found = (await storedDays(service.name)).reverse();
      if (source !== entry.key) return;
      if (found.length === 0) throw new Error("no records yet");
      const today = dateOf(now, state.site);
      days = found;
      newest = days.includes(today) ? today : days[0];
      fill(picker, [days, today], () => days.map((date) => h("option", { value: date }, date === today ? `${date} (today)` : date)));
      picker.value = days.includes(picked) ? picked : newest;
      if (held?.date !== picker.value) await open(picker.value);
    } catch (error) {
      if (source === entry.key && !held) fail(error);
    } finally {
      if (source === entry.key) asking = false;
      asked = performance.now();
    }
  }

  function pick() {
    picked = picker.value === newest ? null : picker.value;
    open(picker.value);
  }

  function clear() {
    plots.clear();
    figures.replaceChildren();
    setText(summary, "");
    setText(shown, "");
    happened.replaceChildren();
    more.hidden = true;
    held = null;
    wish = null;
  }

  function fail(error) {
    clear();
    figures.replaceChildren(h("p", { class: "big" }, "No stored day to show"), h("p", null, sentence(error.message)));
  }

  // Loads one day at a time: a day that is asked for meanwhile waits, and only the last such day counts.
  async function open(date) {
    wish = date;
    if (loading) return;
    loading = true;
    while (wish !== null) {
      const next = wish;
      wish = null;
      await load(next);
    }
    loading = false;
  }

  async function load(date) {
    const begun = performance.now();
    const { service, entry, state } = context;
    const unwanted = () => wish !== null || source !== entry.key;
    setText(shown, `Loading ${date} ...`);
    try {
      const sun = await solarDay(service.name, date, state.site);
      const from = startOf(date, state.site);
      const to = from + DAY_MS;
      const replies = await Promise.all([
        ...KINDS_OF_NUMBERS.map((kind) => numbers(service.name, kind, from, to, entry.name)),
        ...KINDS_OF_LINES.map((kind) => lines(service.name, kind, from, to, entry.name)),
      ]);
      if (unwanted()) return;
      held = { date, sun, from, to, loaded: performance.now(), latitude: state.site.latitude_deg, cut: cut(replies) };
      KINDS.forEach((kind, index) => (held[kind] = replies[index].found));
      const drawing = performance.now();
      draw();
      node.dataset.drawn = Math.round(performance.now() - drawing);
      node.dataset.ready = Math.round(performance.now() - begun);
    } catch (error) {
      if (!unwanted()) fail(error);
    }
  }

  // Adds the records that have come since, while the day goes on.
  async function follow() {
    loading = true;
    const day = held;
    try {
      const { service, entry } = context;
      const replies = await Promise.all([
        ...KINDS_OF_NUMBERS.map((kind) => numbers(service.name, kind, day[kind].time.length ? day[kind].time.at(-1) * 1000 + PAST_MS : day.from, day.to, entry.name)),
        ...KINDS_OF_LINES.map((kind) => lines(service.name, kind, day[kind].length ? Date.parse(day[kind].at(-1).time) + 1 : day.from, day.to, entry.name)),
      ]);
      if (held === day) {
        for (const [index, kind] of KINDS_OF_NUMBERS.entries()) {
          for (const name of Object.keys(day[kind])) day[kind][name].push(...replies[index].found[name]);
        }
        KINDS_OF_LINES.forEach((kind, index) => day[kind].push(...replies[KINDS_OF_NUMBERS.length + index].found));
        day.cut = cut(replies);
        if (KINDS_OF_NUMBERS.some((_, index) => replies[index].found.time.length)) draw();
      }
    } catch {
      // The head of the page says when the service is gone; the day is asked for again.
    }
    day.loaded = performance.now();
    loading = false;
    if (wish !== null) open(wish);
  }

  function draw() {
    const kept = plots.all[0] && held.drawn === held.date ? { ...plots.all[0].scales.x } : null;
    plots.clear();
    figures.replaceChildren();
    const width = figures.clientWidth;
    const put = (...given) => figures.append(plots.add(...given));
    held.spans = spans();
    const [scans, curves] = [held.scans, held.curves].map((columns) => withPauses(columns, SHORT_PAUSE_S));
    const [poses, decisions] = [held.poses, held.decisions].map((columns) => withPauses(columns, LONG_PAUSE_S));
    put("Irradiance", "W/m²", scans.time, FACES.map(([name, colour, line]) => ({ label: name, colour, ...line, values: scans[`${name}_w_m2`], digits: 0 })), { width, height: 240 });
    const estimated = decisions.dni_est.some((value) => value !== null);
    if (estimated) {
      const share = decisions.dhi_est.map((value, i) => (value === null || !(decisions.zenith_w_m2[i] > 20) ? null : Math.min(value / decisions.zenith_w_m2[i], 1.2)));
      put("Light as the law sees it", "W/m²", decisions.time, [{ label: "beam", colour: "#d98200", values: decisions.dni_est, steps: true, digits: 0 }, { label: "diffuse", colour: "#0084c8", dash: [7, 3], values: decisions.dhi_est, steps: true, digits: 0 }], { width, height: 150 });
      put("Diffuse fraction", "of the horizontal irradiance", decisions.time, [{ label: "fraction", colour: "#0084c8", values: share, steps: true, digits: 2 }], { width, height: 120, range: [0, 1.2] });
    }
    const angles = held.sun.path.map((point) => sunAngles(point, held.latitude));
    const sunTimes = held.sun.path.map((point) => Date.parse(point.time) / 1000);
    // Both angles have the same times, so the series are joined once.
    const tables = [[poses.time, poses.a_deg, poses.b_deg], [decisions.time, decisions.target_a_deg, decisions.target_b_deg], [sunTimes, angles.map((pair) => pair && pair[0]), angles.map((pair) => pair && pair[1])]];
    // A pause stays a gap where the other series have times.
    const [x, ...joined] = uPlot.join(tables, tables.map((columns) => columns.map(() => EXPAND)));
    for (const [name, pick, range] of [["A, east negative", 0, [-95, 95]], ["B, flat is 90", 1, [0, 180]]]) {
      const [actual, set, sun] = [joined[pick], joined[2 + pick], joined[4 + pick]];
      put(`Angle ${name}`, "degrees", x, [{ label: "the sun's", colour: "--sun", values: bridged(x, sun), dash: [3, 4] }, { label: "set", colour: "--accent", values: set, steps: true, width: 2 }, { label: "actual", colour: "--ink", values: actual, steps: true }], { width, range });
    }
    const speeds = held.poses.wind_m_s ?? [];
    const read = (_, i) => (speeds[i] ?? null) !== null;
    const wind = withPauses({ time: held.poses.time.filter(read), wind_m_s: speeds.filter(read) }, LONG_PAUSE_S);
    if (wind.time.length) {
      const from = stowsFrom();
      const times = [held.from / 1000, ...wind.time, held.to / 1000];
      put("Wind, strongest since the reading before", "m/s", times, [{ label: "wind", colour: "#0084c8", values: [null, ...wind.wind_m_s, null] }, ...(from === null ? [] : [{ label: "stows from (as set now)", colour: "--bad", values: times.map(() => from), dash: [6, 4] }])], { width, height: 130, range: (_, __, most) => [0, 1.1 * Math.max(most ?? 0, from ?? 0, 1)] });
    }
    if (curves.time.length) put("Power of the module", "W", curves.time, [{ label: "maximum power", colour: "#c2568f", values: curves.pmpp_w }], { width, height: 160 });
    const ends = [held.from / 1000, held.to / 1000];
    put("Modes, and moves below", "", ends, [{ label: "", colour: "--muted", values: [null, null] }], { width, height: 92, bare: true, range: [0, 1], draw: strip });
    held.drawn = held.date;
    if (kept) plots.zoom(kept.min, kept.max);
    else plots.zoom(...ends);
    setText(summary, inWords());
    list();
  }

  // The least wind that stows, of all sources that measure any.
  function stowsFrom() {
    const found = (context.tracker?.wind ?? []).map((source) => source.stow_from_m_s).filter((value) => value !== null);
    return found.length ? Math.min(...found) : null;
  }

  function strip(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    const style = getComputedStyle(document.documentElement);
    for (const { name, from, to } of held.spans) {
      const left = plot.valToPos(from, "x", true);
      const right = plot.valToPos(to, "x", true);
      ctx.fillStyle = style.getPropertyValue(SHADES[KIND[name]] ?? "--track");
      ctx.globalAlpha = 0.45;
      ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height * 0.62);
      ctx.globalAlpha = 1;
      ctx.fillStyle = style.getPropertyValue("--ink");
      ctx.textAlign = "left";
      ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
      if (right - left > ctx.measureText(name).width + 8) ctx.fillText(name, left + 4, bbox.top + bbox.height * 0.4);
    }
    ctx.strokeStyle = style.getPropertyValue("--accent");
    ctx.lineWidth = 1.5 * devicePixelRatio;
    for (const { time } of held.moves) {
      const x = plot.valToPos(Date.parse(time) / 1000, "x", true);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top + bbox.height * 0.7);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  // The modes of the day with their begin and end, none where nothing was recorded.
  function spans() {
    const { mode } = context.tracker ?? {};
    const changes = held.modes.map(({ time, before, after }) => ({ at: Date.parse(time) / 1000, before, after }));
    return recorded().flatMap(([start, end]) => {
      const inside = changes.filter(({ at }) => at >= start && at <= end);
      const first = inside.length ? inside[0].before : mode && Date.parse(mode.since) / 1000 <= start ? mode.name : null;
      const begun = [{ name: first, from: start }, ...inside.map(({ at, after }) => ({ name: after, from: at }))];
      return begun.map((span, index) => ({ ...span, to: begun[index + 1]?.from ?? end }));
    }).filter(({ name, from, to }) => name && to > from);
  }

  // From when to when there are records of any kind. After the end of a kind that was cut off, pauses are not known.
  function recorded() {
    const timesOf = (kind) => held[kind].time ?? held[kind].map(({ time }) => Date.parse(time) / 1000);
    const times = Float64Array.from(KINDS.flatMap(timesOf)).sort();
    if (!times.length) return [];
    const known = Math.min(...held.cut.map((kind) => timesOf(kind).at(-1)));
    const found = [];
    let start = times[0];
    for (let i = 1; i < times.length; i += 1) {
      if (times[i] - times[i - 1] <= LONG_PAUSE_S || times[i - 1] >= known) continue;
      found.push([start, times[i - 1]]);
      start = times[i];
    }
    return [...found, [start, held.cut.length ? Math.min(held.to, context.now) / 1000 : times.at(-1)]];
  }

  function inWords() {
    const travel = held.moves.reduce((sum, move) => sum + Math.abs((move.end_a_deg ?? 0) - (move.from_a_deg ?? 0)) + Math.abs((move.end_b_deg ?? 0) - (move.from_b_deg ?? 0)), 0);
    const hours = {};
    for (const { name, from, to } of held.spans) hours[name] = (hours[name] ?? 0) + to - from;
    const modes = Object.entries(hours).sort((a, b) => b[1] - a[1]).map(([name, seconds]) => `${TITLE[name] ?? name} ${duration(seconds)}`);
    const { sunrise, sunset, highest_elevation_deg } = held.sun;
    const rise = sunrise ? ` from ${localTime(Date.parse(sunrise), false)}` : "";
    const set = sunset ? ` to ${localTime(Date.parse(sunset), false)}` : "";
    const sun = rise || set ? `Sun${rise}${set} local, highest ${deg(highest_elevation_deg)}. ` : "";
    const early = held.cut.length ? ` The day has more records than fit here: ${held.cut.join(", ")} end early.` : "";
    const lasted = modes.length ? ` ${modes.join(", ")}.` : "";
    return `${sun}${counted(held.scans.time.length, "scan")}; ${counted(held.moves.length, "move")} over ${deg(travel)}.${lasted}${early}`;
  }

  function list(most = held.most ?? FEW_LINES) {
    held.most = most;
    const rows = [
      ...held.modes.map(({ time, before, after, why }) => ({ time, text: `${before} -> ${after}: ${why}` })),
      ...held.events.map(({ time, subject, text }) => ({ time, text: `${subject}: ${text}` })),
      ...held.moves.map(ended),
    ].sort((one, other) => other.time.localeCompare(one.time));
    setText(more, `Show all ${rows.length}`);
    more.hidden = rows.length <= most;
    happened.replaceChildren(...rows.slice(0, most).map(({ time, text }) => h("li", null, h("time", { datetime: time }, localTime(Date.parse(time)), h("span", null, ` ${utcTime(Date.parse(time), false)} UTC`)), h("span", null, onPage(sentence(text), Date.parse(time))))));
  }

  function show(part) {
    if (!held) return;
    if (part === "Whole day") plots.zoom(held.from / 1000, held.to / 1000);
    const { sunrise, sunset, path } = held.sun;
    if (part === "Daylight" && (sunrise || sunset)) plots.zoom(Date.parse(sunrise ?? path[0].time) / 1000, Date.parse(sunset ?? path.at(-1).time) / 1000);
    const last = held.scans.time.at(-1);
    if (part === "Last hour" && last) plots.zoom(last - 3600, last);
  }

  picker.addEventListener("change", pick);
  const watcher = new ResizeObserver(() => plots.resize(figures.clientWidth));
  watcher.observe(figures);

  // Tries again what has failed, waits for the day that begins at midnight, and follows the one that goes on.
  function carryOn({ now, state }) {
    const waited = performance.now() - asked;
    if (!held ? waited > AGAIN_MS : waited > FRESH_MS && !days.includes(dateOf(now, state.site))) choose();
    else if (held && held.to > now && performance.now() - held.loaded > FRESH_MS) follow();
  }

  function update(found) {
    context = found;
    if (!found.state) {
      if (!source && found.service.up === false) fail(new Error(`the service at ${found.service.name} ${found.service.why}`));
      return;
    }
    if (source !== found.entry.key) choose();
    else if (!asking && !loading && !found.old) carryOn(found);
    setAttr(node, "data-source", source);
  }

  // Gives up requests that are under way. A reply that comes all the same belongs to no source, and is not drawn.
  function close() {
    watcher.disconnect();
    source = null;
    giveUp();
    clear();
  }

  return { node, update, redraw: () => held && draw(), close };
}

// A move as the service tells it among its news, at its end: the same move must read the same in all views.
function ended({ time, duration_s, end_a_deg, end_b_deg, outcome, why }) {
  const [a, b] = [end_a_deg, end_b_deg].map((angle) => num(angle, 1).replace("−", "-"));
  const place = `A ${a.startsWith("-") ? "" : "+"}${a}, B ${b} deg`;
  const how = outcome === "arrived" ? "" : ` (${outcome})`;
  return { time: new Date(Date.parse(time) + 1000 * duration_s).toISOString(), text: `moved to ${place} in ${num(duration_s)} s${how}: ${why}` };
}

// The kinds that have more records than a reply holds.
const cut = (replies) => KINDS.filter((_, index) => replies[index].more);

// The angles A and B that point at the sun; null while it is down.
function sunAngles({ azimuth_deg, elevation_deg }, latitude) {
  if (elevation_deg <= 0) return null;
  const [east, north, up] = direction(azimuth_deg, elevation_deg);
  const equatorward = latitude >= 0 ? -north : north;
  return [(Math.asin(-east) * 180) / Math.PI, (Math.atan2(up, equatorward) * 180) / Math.PI];
}

// Interpolates between the known points, so that a line at the times of other series is whole.
function bridged(x, values) {
  const found = new Array(values.length).fill(null);
  let before = -1;
  for (let i = 0; i < values.length; i += 1) {
    if (values[i] === null || values[i] === undefined) continue;
    if (before >= 0 && x[i] - x[before] < 1300) for (let k = before + 1; k < i; k += 1) found[k] = values[before] + ((values[i] - values[before]) * (x[k] - x[before])) / (x[i] - x[before]);
    found[i] = values[i];
    before = i;
  }
  return found;
}
