// The one stream of events: the same code runs in a shared worker, or in the page where there is none.

const SILENT_MS = 7000;
const AGAIN_MS = 2000;

export class Stream {
  constructor(send) {
    this.send = send;
    this.source = null;
    this.again = 0;
    this.watch = 0;
    this.newest = new Map();
  }

  open() {
    if (this.source) return;
    this.source = new EventSource("/events");
    for (const kind of ["hello", "beat", "message"]) this.source.addEventListener(kind, (event) => this.take(kind, event.data));
    this.source.addEventListener("error", () => this.lost());
    this.await();
  }

  close() {
    clearTimeout(this.again);
    clearTimeout(this.watch);
    this.source?.close();
    this.source = null;
    // A tab that is opened later would take these messages for the present state.
    this.newest.clear();
  }

  take(kind, data) {
    this.await();
    const message = { kind, data: data ? JSON.parse(data) : null };
    if (kind !== "beat") this.newest.set(message.data.service ?? kind, message);
    this.send(message);
  }

  await() {
    clearTimeout(this.watch);
    this.watch = setTimeout(() => this.lost(), SILENT_MS);
  }

  lost() {
    this.close();
    this.send({ kind: "lost", data: null });
    this.again = setTimeout(() => this.open(), AGAIN_MS);
  }
}
