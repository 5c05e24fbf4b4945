// Stored days from a service: packed columns of numbers, and rows of words.

async function read(what, service, query) {
  const parameters = new URLSearchParams({ service, ...query });
  const reply = await fetch(`/read/${what}?${parameters}`);
  if (!reply.ok) {
    const { error } = await reply.json().catch(() => ({}));
    throw new Error(error ?? `The service answers ${reply.status}.`);
  }
  return reply;
}

export async function storedDays(service) {
  return (await (await read("days", service, {})).json()).days;
}

// Rise, noon, set and path of the solar day that a date names at the site.
export async function solarDay(service, date, longitude) {
  const noon = Date.parse(`${date}T12:00:00Z`) - longitude * 240e3;
  return (await read("sun", service, { at: new Date(noon).toISOString() })).json();
}

const span = (from, to, tracker) => ({ from: new Date(from).toISOString(), to: new Date(to).toISOString(), ...(tracker ? { tracker } : {}) });

// Returns the columns as arrays by name, times as seconds of UTC.
export async function numbers(service, kind, from, to, tracker) {
  const buffer = await (await read(`history/${kind}`, service, span(from, to, tracker))).arrayBuffer();
  const end = new Uint8Array(buffer).indexOf(10);
  const head = JSON.parse(new TextDecoder().decode(buffer.slice(0, end)));
  // Views need an even place; what follows the head is copied to one.
  const values = new Float32Array(buffer.slice(end + 1));
  const found = {};
  head.columns.forEach((name, index) => {
    found[name] = Array.from(values.subarray(index * head.rows, (index + 1) * head.rows), (value) => (Number.isNaN(value) ? null : value));
  });
  found.time = found.time_s.map((value) => head.start + value);
  delete found.time_s;
  return found;
}

export async function lines(service, kind, from, to, tracker) {
  return (await (await read(`history/${kind}`, service, span(from, to, tracker))).json()).rows;
}
