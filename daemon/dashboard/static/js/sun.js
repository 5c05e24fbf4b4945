// The sun's path of the day that a service is in, asked for once a day.

import { dateOf, solarDay } from "./history.js";

const paths = new Map();
const AGAIN_MS = 10000;

export function sunOf(service, now) {
  const site = service.state?.site;
  if (!site || !Number.isFinite(now)) return null;
  const known = paths.get(service.name);
  if (known?.path && known.site === JSON.stringify(site) && now >= known.from && now < known.to) return known;
  if (known && performance.now() - known.asked < AGAIN_MS) return known.path ? known : null;
  paths.set(service.name, { asked: performance.now() });
  load(service.name, site, now);
  return null;
}

async function load(name, site, now) {
  try {
    const day = await solarDay(name, dateOf(now, site), site);
    const from = Date.parse(day.path[0].time);
    paths.set(name, { ...day, site: JSON.stringify(site), from, to: Date.parse(day.path.at(-1).time), asked: performance.now() });
  } catch {
    // It is asked for again in a while.
  }
}
