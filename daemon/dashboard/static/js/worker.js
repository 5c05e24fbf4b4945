// One stream for all tabs: a browser holds six connections to a host, and a seventh tab would wait for ever.

import { Stream } from "./stream.js";

const ports = new Map();
const stream = new Stream((message) => {
  for (const port of ports.keys()) port.postMessage(message);
});

function settle() {
  if ([...ports.values()].some((visible) => visible)) stream.open();
  else stream.close();
}

self.onconnect = (event) => {
  const [port] = event.ports;
  port.onmessage = ({ data }) => {
    if (data === "bye") ports.delete(port);
    else {
      const fresh = !ports.has(port);
      ports.set(port, data === "visible");
      if (fresh) for (const message of stream.newest.values()) port.postMessage(message);
    }
    settle();
  };
};
