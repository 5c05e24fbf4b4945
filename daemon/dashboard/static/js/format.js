// Numbers, times and words as people read them. What is not known is a dash.

export const UNKNOWN = "–";

// A space at which no line ends: a number stays with its unit.
const FIRM = "\u00a0";

const known = (value) => typeof value === "number" && Number.isFinite(value);

export function num(value, digits = 0, unit = "") {
  if (!known(value)) return UNKNOWN;
  const text = value.toFixed(digits);
  const clean = Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
  return unit ? `${clean}${FIRM}${unit}` : clean;
}

// How many there are of something whose plural has an s.
export const counted = (value, one) => `${num(value)} ${one}${value === 1 ? "" : "s"}`;

export function deg(value, digits = 1) {
  return known(value) ? `${num(value, digits)}°` : UNKNOWN;
}

export function signedDeg(value, digits = 1) {
  if (!known(value)) return UNKNOWN;
  const text = deg(value, digits);
  return Number(value.toFixed(digits)) > 0 ? `+${text}` : text;
}

export function signed(value, digits, unit) {
  const text = num(value, digits, unit);
  return known(value) && Number(value.toFixed(digits)) > 0 ? `+${text}` : text;
}

export function duration(seconds) {
  if (!known(seconds)) return UNKNOWN;
  const s = Math.max(0, seconds);
  const of = (value, unit) => `${value}${FIRM}${unit}`;
  if (s < 9.95) return of(s.toFixed(1), "s");
  if (s < 99.5) return of(Math.round(s), "s");
  const minutes = Math.round(s / 60);
  if (minutes < 60) return of(minutes, "min");
  if (minutes < 48 * 60) return `${of(Math.floor(minutes / 60), "h")} ${of(minutes % 60, "min")}`;
  return `${of(Math.floor(minutes / 1440), "d")} ${of(Math.floor((minutes % 1440) / 60), "h")}`;
}

// A countdown has to be exact where it is short.
export function countdown(seconds) {
  if (!known(seconds)) return UNKNOWN;
  const s = Math.max(0, Math.round(seconds));
  return `${Math.floor(s / 60)}:${String(s % 60).padStart(2, "0")}${FIRM}min`;
}

const two = (value) => String(value).padStart(2, "0");

export function utcTime(ms, withSeconds = true) {
  const at = new Date(ms);
  const text = `${two(at.getUTCHours())}:${two(at.getUTCMinutes())}`;
  return withSeconds ? `${text}:${two(at.getUTCSeconds())}` : text;
}

export function localTime(ms, withSeconds = true) {
  const at = new Date(ms);
  const text = `${two(at.getHours())}:${two(at.getMinutes())}`;
  return withSeconds ? `${text}:${two(at.getSeconds())}` : text;
}

export const utcDay = (ms) => new Date(ms).toISOString().slice(0, 10);

export function localDay(ms) {
  const at = new Date(ms);
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())}`;
}

// "11:27 local (09:27 UTC)", with the local day where it is another one than that of `now`.
export function at(iso, now) {
  if (!iso) return UNKNOWN;
  const ms = Date.parse(iso);
  const day = now !== undefined && localDay(ms) !== localDay(now) ? `${localDay(ms)} ` : "";
  return `${day}${localTime(ms, false)}${FIRM}local (${utcTime(ms, false)}${FIRM}UTC)`;
}

// The words on the orders' buttons.
export const BUTTONS = {
  stow: "Stow", stop: "Stop", hold: "Hold", auto: "Auto", snow: "Snow", maintenance: "Maintenance", home: "Reference run", clear: "Clear faults", relearn: "Relearn the site",
};

// The button that does the same as a command of the terminal; null where the page has none.
export function buttonOf(command) {
  const [, name, rest] = /^heliocube (alarms ack|\w+)(.*)$/.exec(command) ?? [];
  if (name === "alarms ack") return "Acknowledge";
  return Object.hasOwn(BUTTONS, name) && /^( --tracker \S+)?$/.test(rest) ? BUTTONS[name] : null;
}

// A service's sentence as the page shows it: UTC times as `at` writes them, commands by the page's own buttons.
export function onPage(text, now) {
  const local = text.replace(/(\d{4}-\d\d-\d\d) (\d\d:\d\d(?::\d\d)?) UTC/g, (written, day, time) => {
    const iso = `${day}T${time}Z`;
    return Number.isNaN(Date.parse(iso)) ? written : at(iso, now);
  });
  return local.replace(/'(heliocube [^']*)'/g, (written, command) => buttonOf(command) ?? written);
}

export const sentence = (text) => (text ? text[0].toUpperCase() + text.slice(1) : "");
