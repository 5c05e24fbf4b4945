// What is known of all services now, and since when.

import { Stream } from "./stream.js";

export class Live {
  // renewed: called when the dashboard has other files than this page.
  constructor(changed, renewed) {
    this.changed = changed;
    this.renewed = renewed;
    this.services = new Map();
    this.page = document.documentElement.dataset.page;
    this.named = false;
    this.connected = null;
    this.lostAt = null;
    this.ahead = NaN;
    this.start();
  }

  start() {
    if ("SharedWorker" in window) {
      // One worker for all pages of the same files: after an upgrade, an older page in another tab keeps its own.
      const { port } = new SharedWorker(`/static/js/worker.js?${this.page}`, { type: "module", name: "heliocube" });
      port.onmessage = ({ data }) => this.take(data);
      const tell = () => port.postMessage(document.visibilityState);
      document.addEventListener("visibilitychange", tell);
      window.addEventListener("pagehide", () => port.postMessage("bye"));
      window.addEventListener("pageshow", tell);
    } else {
      const stream = new Stream((message) => this.take(message));
      const settle = () => (document.visibilityState === "visible" ? stream.open() : stream.close());
      document.addEventListener("visibilitychange", settle);
      settle();
    }
  }

  take({ kind, data }) {
    if (kind === "lost") {
      if (this.connected !== false) this.lostAt = Date.now();
      this.connected = false;
    } else this.connected = true;
    if (kind === "beat") this.ahead = data - performance.now() / 1000;
    if (kind === "hello") {
      if (this.page !== data.page) this.renewed();
      this.named = true;
      for (const name of this.services.keys()) if (!data.services.includes(name)) this.services.delete(name);
      for (const name of data.services) if (!this.services.has(name)) this.services.set(name, { name, up: null, why: null, state: null });
    }
    if (kind === "message") {
      const service = this.services.get(data.service) ?? { name: data.service, state: null };
      service.up = data.up;
      service.why = data.why ?? null;
      if (data.state) {
        service.state = data.state;
        service.at = { running: performance.now(), wall: Date.now() };
        service.atUtc = Date.parse(data.state.time);
      }
      this.services.set(data.service, service);
    }
    this.changed();
  }

  // The dashboard's time [s], as far as is known: clocks of machines differ.
  get dashboardTime() {
    return this.ahead + performance.now() / 1000;
  }

  // All trackers of all services; a cube's process, which has none, is an entry without one.
  get trackers() {
    const found = [];
    for (const service of this.services.values()) {
      const own = Object.entries(service.state?.trackers ?? {});
      if (own.length === 0) found.push({ key: service.name, service, name: null, tracker: null });
      for (const [name, tracker] of own) found.push({ key: `${service.name}/${name}`, service, name, tracker });
    }
    const count = new Map();
    for (const entry of found) {
      const site = entry.service.state?.site.name ?? entry.service.name;
      entry.label = entry.name ? `${entry.name}, ${site}` : entry.service.state ? `cube, ${site}` : entry.service.name;
      count.set(entry.label, (count.get(entry.label) ?? 0) + 1);
    }
    for (const entry of found) if (count.get(entry.label) > 1) entry.label += ` (${entry.service.name})`;
    return found;
  }

  // The tracker of a key among these or, while its service does not name it, an entry that says why: an order for one
  // tracker must never go to another. The key of a service, chosen before it named its trackers, means its first one.
  entry(key, trackers) {
    const found = trackers.find((each) => each.key === key || each.service.name === key);
    if (found) return found;
    const [address, name = null] = key.split("/");
    const service = { name: address, up: null, ...this.services.get(address) };
    let why = service.why;
    if (this.named && !this.services.has(address)) why = "is no longer one of this dashboard's: choose another tracker";
    else if (service.state) why = `has no tracker ${name} any more: choose another`;
    if (why !== service.why) Object.assign(service, { up: false, why, state: null });
    return { key, service, name, tracker: null, label: name ? `${name}, ${address}` : address };
  }
}

// How long ago a state came [ms]. The running clock stands still while a machine sleeps, and the wall clock may be set.
// The longer time counts: if it is wrong, that lasts until the next state; the shorter could make an old one look new.
const since = ({ running, wall }) => Math.max(performance.now() - running, Date.now() - wall);

// How long ago in the service's time its state was taken [s].
export function elapsed(service) {
  return service.at === undefined ? NaN : (since(service.at) / 1000) * (service.state?.speed ?? 1);
}

// The service's own time now, as far as is known [ms].
export function serviceNow(service) {
  return service.atUtc + elapsed(service) * 1000;
}

// Whether what is shown of a service is no longer kept up to date.
export function isOld(service, connected) {
  return connected === false || !service.up || since(service.at) > 5000;
}
