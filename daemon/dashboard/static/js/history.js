// Stored days from a service: packed columns of numbers, and rows of words.

export const DAY_MS = 86400e3;

// A browser holds six connections to a host, and one has the stream. A service that hangs keeps each of its readers for
// half a minute: orders must always find a connection free.
const AT_ONCE = 2;
const waiting = [];
let reading = 0;
let shown = { service: null, left: null };

// One service is shown at a time: requests to another that are still under way are given up.
function leaving(service) {
  if (service !== shown.service) {
    giveUp();
    shown = { service, left: new AbortController() };
  }
  return shown.left.signal;
}

// Gives up requests that are still under way: to a service that hangs, they would keep the next ones waiting.
export function giveUp() {
  shown.left?.abort();
  shown = { service: null, left: null };
}

async function read(what, service, query) {
  const signal = leaving(service);
  if (reading >= AT_ONCE) await new Promise((resolve) => waiting.push(resolve));
  else reading += 1;
  try {
    return await readNow(what, service, query, signal);
  } finally {
    if (waiting.length) waiting.shift()();
    else reading -= 1;
  }
}

async function readNow(what, service, query, signal) {
  const parameters = new URLSearchParams({ service, ...query });
  const reply = await fetch(`/read/${what}?${parameters}`, { signal });
  if (!reply.ok) {
    // Whether the dashboard or the service refuses: only an older version lacks this page.
    if (reply.status === 404) throw new Error("the service is of an earlier version, which gives no stored days");
    const { error } = await reply.json().catch(() => ({}));
    throw new Error(error ?? `The service answers ${reply.status}.`);
  }
  // The connection is free once the whole reply is here.
  return new Response(await reply.arrayBuffer());
}

export async function storedDays(service) {
  return (await (await read("days", service, {})).json()).days;
}

// When the mean solar day of a date begins at the site [ms], and the date of the solar day that an instant falls in.
export const startOf = (date, site) => Date.parse(`${date}T00:00:00Z`) - site.longitude_deg * 240e3;
export const dateOf = (at, site) => new Date(at + site.longitude_deg * 240e3).toISOString().slice(0, 10);

const suns = new Map();
const MOST_SUNS = 32;

// Rise, noon, set and path of the solar day that a date names at the site; requests for the same day at once share one
// answer.
export function solarDay(service, date, site) {
  const noon = startOf(date, site) + DAY_MS / 2;
  const key = JSON.stringify([service, date, site]);
  if (!suns.has(key)) {
    if (suns.size >= MOST_SUNS) suns.clear();
    const asked = read("sun", service, { at: new Date(noon).toISOString() }).then((reply) => reply.json());
    suns.set(key, asked);
    asked.catch(() => suns.delete(key));
  }
  return suns.get(key);
}

const span = (from, to, tracker) => ({ from: new Date(from).toISOString(), to: new Date(to).toISOString(), ...(tracker ? { tracker } : {}) });

// Returns the columns as arrays by name, times as seconds of UTC, and whether there are more rows than a reply has.
export async function numbers(service, kind, from, to, tracker) {
  const buffer = await (await read(`history/${kind}`, service, span(from, to, tracker))).arrayBuffer();
  const end = new Uint8Array(buffer).indexOf(10);
  const head = JSON.parse(new TextDecoder().decode(buffer.slice(0, end)));
  // A Float32Array needs an aligned offset, so the bytes behind the head are copied.
  const values = new Float32Array(buffer.slice(end + 1));
  const found = {};
  head.columns.forEach((name, index) => {
    // A loop, because a function call for each of 300,000 values is noticed on a slow machine.
    const column = new Array(head.rows);
    for (let row = 0, place = index * head.rows; row < head.rows; row += 1, place += 1) column[row] = Number.isNaN(values[place]) ? null : values[place];
    found[name] = column;
  });
  found.time = found.time_s.map((value) => head.start + value);
  delete found.time_s;
  return { found, more: head.more };
}

// The same columns with a row of nulls in the middle of each pause, so that no line crosses it: where times lie further
// apart than `least` [s] and than three usual intervals.
export function withPauses(columns, least) {
  const { time } = columns;
  const intervals = new Float64Array(Math.max(time.length - 1, 0));
  for (let i = 0; i < intervals.length; i += 1) intervals[i] = time[i + 1] - time[i];
  const longest = Math.max(least, 3 * (intervals.slice().sort()[intervals.length >> 1] ?? 0));
  const places = [];
  intervals.forEach((interval, i) => interval > longest && places.push(i + 1));
  if (places.length === 0) return columns;
  const parted = (values, between) => [...values.slice(0, places[0]), ...places.flatMap((place, n) => [between(place), ...values.slice(place, places[n + 1])])];
  return Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, parted(values, (place) => (name === "time" ? (time[place - 1] + time[place]) / 2 : null))]));
}

export async function lines(service, kind, from, to, tracker) {
  const { rows, more } = await (await read(`history/${kind}`, service, span(from, to, tracker))).json();
  return { found: rows, more };
}
