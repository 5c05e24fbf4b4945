// Who is logged in here, and the operator's commands: every one says what it will do and is answered by the tracker.

import { h, icon, setText } from "./dom.js";
import { onPage, sentence } from "./format.js";
import { wishList } from "./views/hero.js";

const WORDS = {
  stow: { title: "Stow", about: "The tracker goes to its stow position and stays there until Auto." },
  snow: { title: "Snow", about: "The tracker goes to the steep position that sheds snow and hail, and stays until Auto." },
  maintenance: { title: "Maintenance", about: "Nothing moves and no alarm sounds until Auto. Before work on the mechanics switch the motors' supply off: software is no emergency stop." },
  auto: { title: "Auto", about: "Ends stop, maintenance, stow, snow, hold and goto. The tracker may move at once: is nobody near it?" },
  home: { title: "Reference run", about: "Both axes move over their whole range. Is nobody near the tracker?" },
  clear: { title: "Clear faults", about: "Forgives the faults and doubts that are shown, without a reference run. The tracker may move at once." },
  relearn: { title: "Relearn", about: "The law forgets what it has learned of this site: albedo and gains." },
};

const ONCE_IN = "It is given once you have logged in.";

// A double-click takes less time.
const MEANT_MS = 500;
// A service answers within 6 s, and the dashboard gives it up after 30 s at most.
const LATE_MS = 10000;
const GONE_MS = 40000;

// Drops what was pressed if the page, or the whole machine, delivers it late: nobody expects its effect any more.
// A stop is never dropped.
export function dropLatePresses(say) {
  const drop = (event) => {
    const late = performance.now() - event.timeStamp;
    if (late < LATE_MS || event.target.closest?.("button.stop")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    say(`The page stood still for ${Math.round(late / 1000)} s: what was pressed meanwhile is not done.`, "warn");
  };
  for (const kind of ["click", "keydown"]) window.addEventListener(kind, drop, true);
}

async function call(path, body) {
  const gone = new AbortController();
  const limit = setTimeout(() => gone.abort(), GONE_MS);
  const sent = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  let reply;
  try {
    reply = await fetch(path, { ...sent, signal: gone.signal });
  } catch {
    throw new Error("The dashboard does not answer");
  } finally {
    clearTimeout(limit);
  }
  const found = await reply.json().catch(() => ({}));
  if (!reply.ok) throw Object.assign(new Error(found.error ?? `The dashboard answers ${reply.status}.`), { status: reply.status });
  return found;
}

export class Orders {
  // time: returns the dashboard's time, which each order carries: the dashboard refuses an order that was long under
  // way. now: returns the service's time, by which its sentences are told.
  constructor(outcome, changed, time, now = Date.now) {
    this.outcome = outcome;
    // By order: what is said of it, and whether it is under way.
    this.lines = new Map();
    this.changed = changed;
    this.time = time;
    this.now = now;
    const unknown = { by: null, services: [] };
    this.session = unknown;
    // All tabs of a browser have one login: a stop can then be given in any of them.
    this.tabs = new BroadcastChannel("session");
    this.tabs.addEventListener("message", ({ data }) => this.set(data));
    // If somebody has logged in before the answer comes, the answer is out of date.
    call("/session").then((session) => this.session === unknown && this.set(session), () => {});
  }

  set(session) {
    this.session = session;
    this.changed();
  }

  // Takes a session that was begun, changed or ended here, and tells the other tabs.
  change(session) {
    this.set(session);
    this.tabs.postMessage(session);
  }

  get busy() {
    return document.querySelector("dialog") !== null || [...this.lines.values()].some(({ underWay }) => underWay);
  }

  may(service) {
    return this.session.services.includes(service);
  }

  async logout() {
    try {
      this.change(await call("/logout", {}));
      this.say("Logged out.", "ok");
    } catch (error) {
      this.say(`Not logged out: ${sentenceOf(error)}`, "bad");
    }
  }

  // Asks for the token once; resolves to whether the service has taken it, or any service if none is given.
  login(service, about = "Orders need the service's token. Looking does not.") {
    return new Promise((resolve) => {
      let tried = false;
      const problem = h("p", { class: "problem", role: "alert" });
      const by = h("input", { name: "by", autocomplete: "username", required: true, maxlength: 60, value: localStorage.getItem("by") ?? "" });
      const token = h("input", { name: "token", type: "password", autocomplete: "current-password", required: true, maxlength: 600 });
      const form = h("form", { method: "dialog" },
        h("h2", null, "Log in"), h("p", null, about),
        h("label", null, "Your name, for the records", by),
        h("label", null, "Token", token),
        h("p", { class: "hint" }, "The line in the service's api.token. A service without that file shows a token where it was started."),
        problem,
        h("div", { class: "choices" }, h("button", { type: "button", class: "plain", onclick: () => dialog.close() }, "Cancel"), h("button", { type: "submit", class: "strong" }, "Log in")));
      const dialog = this.open(form, () => resolve(service ? this.may(service) : this.session.by !== null));
      form.addEventListener("submit", async (event) => {
        event.preventDefault();
        // Five wrong tokens in a minute keep everybody out: on a slow line, no second one is sent before the answer.
        if (tried) return;
        tried = true;
        problem.className = "hint";
        problem.textContent = "The token is being tried ...";
        try {
          this.change(await call("/login", { by: by.value, token: token.value }));
          localStorage.setItem("by", by.value);
          dialog.close();
        } catch (error) {
          problem.className = "problem";
          problem.textContent = sentenceOf(error);
        } finally {
          tried = false;
        }
      });
      (by.value ? token : by).focus();
    });
  }

  open(content, closed) {
    const dialog = h("dialog", { "aria-label": content.querySelector("h2").textContent }, content);
    dialog.addEventListener("close", () => {
      dialog.remove();
      closed();
    });
    document.body.append(dialog);
    dialog.showModal();
    return dialog;
  }

  // Asks whether the order is meant, and shows what it would end; resolves to the reason to note, or null.
  confirm(name, whom, ends = []) {
    return new Promise((resolve) => {
      let answer = null;
      const why = h("input", { name: "why", maxlength: 200, autocomplete: "off" });
      // Neither the second half of the double-click nor the held key that has opened the question may answer it. Unlike
      // a disabled button, this one can have the focus from the start.
      const yes = h("button", { type: "submit", class: `go ${name}`, "aria-disabled": "true" }, icon(name), `${WORDS[name].title} now`);
      const no = h("button", { type: "button", class: "plain wide", onclick: () => dialog.close() }, "Cancel");
      const form = h("form", { method: "dialog" }, h("h2", null, `${WORDS[name].title}: ${whom}`), h("p", null, WORDS[name].about), ends, yes,
        h("label", null, "Reason, for the records (may stay empty)", why), no);
      const dialog = this.open(form, () => resolve(answer));
      form.addEventListener("submit", (event) => {
        if (yes.hasAttribute("aria-disabled")) event.preventDefault();
        else answer = why.value.trim();
      });
      form.addEventListener("keydown", (event) => event.repeat && event.key === "Enter" && event.preventDefault());
      setTimeout(() => yes.removeAttribute("aria-disabled"), MEANT_MS);
      (name === "stow" ? yes : no).focus();
    });
  }

  // Asks for the token of a tracker's service; resolves to whether orders can be given now, and says so if they cannot.
  async admitted(name, entry, about) {
    const service = entry.service.name;
    if (await this.login(service, about)) return true;
    this.say(`${name} for ${entry.label} was NOT given: it needs the token of the service at ${service}.`, "bad");
    return false;
  }

  // Gives an order to one tracker and says what came of it.
  async give(name, entry, more = {}) {
    const service = entry.service.name;
    if (!this.may(service) && !(await this.admitted(name, entry, `${sentence(name)} for ${entry.label} needs the service's token. ${ONCE_IN}`))) return false;
    const body = { service, name, ...more };
    if (entry.name) body.tracker = entry.name;
    return this.carryOut(name, entry.label, () => call("/command", { ...body, given_s: this.time() }), service);
  }

  // Says that a person has seen an alarm; an alarm of the cube belongs to no tracker. The second half of a double-click
  // does not count: the next alarm may have taken this one's place, and nobody has seen that.
  acknowledge(alarm, entry) {
    const before = this.acknowledgedAt ?? -Infinity;
    this.acknowledgedAt = performance.now();
    if (this.acknowledgedAt - before < MEANT_MS) return false;
    return this.give("acknowledge", { ...entry, name: alarm.tracker }, { alarm: alarm.name });
  }

  async ask(name, entry) {
    if (!this.may(entry.service.name) && !(await this.admitted(name, entry))) return false;
    // The service ends nothing that came later than this question: nobody releases a stop that they have not seen.
    const wishes = name === "auto" ? Object.entries(entry.tracker.wishes).filter(([, wish]) => wish) : [];
    const shown = name === "auto" ? { shown: Object.fromEntries(wishes.map(([wish, { since, latest }]) => [wish, latest ?? since])) } : {};
    const why = await this.confirm(name, entry.label, wishList(Object.fromEntries(wishes), this.now()));
    return why === null ? false : this.give(name, entry, { ...shown, ...(why ? { why } : {}) });
  }

  // Stows or stops every tracker of every service; resolves to what came of it at each, or null.
  async giveAll(name) {
    if (!this.session.by && !(await this.login(null))) return null;
    // As for one tracker, a stop asks no question.
    const why = name === "stop" ? "" : await this.confirm(name, "all trackers");
    return why === null ? null : this.giveEach(name, why ? { why } : {});
  }

  async giveEach(name, body, order = {}) {
    const word = sentence(name);
    try {
      const { results } = await this.awaited(order, `${word}: sent to all`, () => call(`/${name}-all`, { ...body, given_s: this.time() }));
      const refused = results.filter(({ accepted }) => !accepted).length;
      this.say(refused ? `${word} was NOT taken by ${refused} of ${results.length} services: see the list` : `${word} was taken by ${results.length === 1 ? "the service" : `all ${results.length} services`}.`, refused ? "bad" : "ok", order);
      const locked = results.find(({ status }) => status === 401);
      if (locked && (await this.renewed({ status: 401, message: locked.text }, locked.service))) return this.giveEach(name, body, order);
      return results;
    } catch (error) {
      if (await this.renewed(error, null, `${word} for all`, order)) return this.giveEach(name, body, order);
      this.say(`${word} for all: ${outcomeOf(error)}`, "bad", order);
      return null;
    }
  }

  async carryOut(name, whom, action, service, order = {}) {
    try {
      const found = await this.awaited(order, `${name}: sent to ${whom}`, action);
      const text = found.text ?? "";
      const seen = { done: "ok", "under-way": "ok", "not-seen": "warn" }[found.state] ?? "ok";
      this.say(seen === "warn" ? `${name} for ${whom}: no effect seen yet, look at the tracker: ${text}` : `${name} for ${whom}: ${text}`, seen, order);
      return true;
    } catch (error) {
      if (await this.renewed(error, service, `${name} for ${whom}`, order)) return this.carryOut(name, whom, action, service, order);
      this.say(`${name} for ${whom}: ${outcomeOf(error)}`, "bad", order);
      return false;
    }
  }

  // Whether an order was refused for want of a session or of the service's token, and a login has ended that. what: the
  // order, if the page shows it as sent.
  async renewed(error, service, what = null, order = {}) {
    if (error.status !== 401) return false;
    if (what) this.say(`${what} was NOT given: log in first.`, "bad", order);
    const before = this.session.by;
    const { by, services } = await call("/session").catch(() => this.session);
    this.change({ by, services: services.filter((each) => each !== service) });
    const why = before !== null && by === null ? "Your login has ended: after 30 days without use, by a restart of the dashboard, or by a logout in another tab." : sentenceOf(error);
    return this.login(service, what ? `${why} ${sentence(what)} was NOT given. ${ONCE_IN}` : why);
  }

  // Says what is under way, and after a while that its answer is late.
  async awaited(order, what, action) {
    this.say(`${what} ...`, "wait", order, true);
    const late = setTimeout(() => this.say(`${what}, and no answer yet: look at the tracker.`, "warn", order, true), LATE_MS);
    try {
      return await action();
    } finally {
      clearTimeout(late);
    }
  }

  // A new order takes the place of those that are answered. An order that is under way keeps a line of its own, so that
  // its answer, which may be a refusal, is seen and does not hide that of a later stop.
  say(text, kind, order = {}, underWay = false) {
    if (!this.lines.has(order)) for (const [other, line] of this.lines) if (!line.underWay) this.drop(other);
    const { node } = this.lines.get(order) ?? { node: h("p", null) };
    this.lines.set(order, { node, kind, underWay });
    setText(node, onPage(text[0].toUpperCase() + text.slice(1), this.now()));
    if (!this.outcome.firstChild) this.outcome.append(h("div", null), h("button", { type: "button", class: "plain", "aria-label": "Dismiss this message", onclick: () => this.say0() }, "×"));
    if (!node.isConnected) this.outcome.firstChild.append(node);
    const worst = ["bad", "warn", "wait", "ok"].find((each) => [...this.lines.values()].some((line) => line.kind === each));
    this.outcome.dataset.kind = worst;
    clearTimeout(this.timer);
    if (worst === "ok") this.timer = setTimeout(() => this.say0(), 20000);
  }

  drop(order) {
    this.lines.get(order).node.remove();
    this.lines.delete(order);
  }

  say0() {
    this.lines.clear();
    this.outcome.replaceChildren();
    delete this.outcome.dataset.kind;
  }
}

const outcomeOf = (error) => `${error.status === 401 ? "NOT given. " : ""}${sentenceOf(error)}${error.status ? "" : " The order may not have arrived: look at the tracker."}`;

function sentenceOf(error) {
  const text = error.message;
  return text[0].toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".");
}
