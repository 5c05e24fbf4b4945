// A stream in place of the browser's own, and a day that comes over it.

delete window.SharedWorker;

window.EventSource = class {
  constructor() {
    this.told = {};
    window.stream = this;
  }

  addEventListener(kind, listener) {
    (this.told[kind] ??= []).push(listener);
  }

  tell(kind, data) {
    for (const listener of this.told[kind] ?? []) listener({ data: JSON.stringify(data) });
  }

  close() {}
};

// Lets the page do what waits.
function breath() {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = resolve;
    port2.postMessage(0);
  });
}

function stateAt(state, second) {
  const begun = Date.parse(state.time);
  const at = (when) => new Date(begun + 1000 * when).toISOString();
  const found = structuredClone(state);
  const wave = Math.sin(second / 300);
  const stopped = second % 3600 < 300;
  found.time = at(second);
  for (const part of [found, ...Object.values(found.trackers)]) {
    Object.assign(part.tracker.pose, { a_deg: 50 * wave, b_deg: 60 + 25 * wave, time: at(second) });
    part.wind[0].speed_m_s = 8 + 7 * wave;
    part.today.moves = second % 300;
    part.next_decision_s = 300 - (second % 300);
    part.mode = { name: "tracking", asked: null, since: at(second - (second % 900)), why: `reason ${Math.floor(second / 900)}` };
    if (stopped) {
      part.wishes.stop = { why: "a hand near", by: "ana", since: at(second - (second % 3600)) };
      Object.assign(part.mode, { name: "hold", asked: "stop" });
    }
  }
  Object.values(found.scan.faces).forEach((face, index) => {
    face.irradiance_w_m2 = 500 + 400 * Math.sin(second / (40 + index));
  });
  found.scan.sequence = second;
  const minute = Math.floor(second / 60);
  found.news = Array.from({ length: 50 }, (_, back) => ({ time: at(60 * (minute - back)), text: `news of minute ${minute - back}` }));
  if (second % 1800 < 600) found.alarms = [alarm(at(second), second % 600)];
  return found;
}

function alarm(time, tries) {
  return {
    name: "move-failed", severity: "critical", state: "raised", text: `try ${tries}`, cause: "", effect: "",
    remedy: "look, then `heliocube clear`", latched: true, since: time, raised_at: time,
    acknowledged_at: null, acknowledged_by: null, cleared_at: null, tracker: null,
  };
}

async function live({ state, from, to }) {
  const service = "127.0.0.1:1";
  window.stream.tell("hello", { version: "test", page: document.documentElement.dataset.page, services: [service] });
  for (let second = from; second < to; second += 1) {
    const gone = second % 7200 < 20;
    const told = gone ? { up: false, why: "does not answer" } : { up: true, state: stateAt(state, second) };
    window.stream.tell("message", { service, ...told });
    await breath();
  }
}

window.live = live;
