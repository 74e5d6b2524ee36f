// The page: its stream from the server, and the parts that show what it receives.

import { byId, setText } from "./dom.js";
import { showDetails } from "./details.js";
import { showGraph } from "./graph.js";
import { showHistory } from "./history.js";
import { showLog, takeLines } from "./log.js";
import { showNodes } from "./nodes.js";
import { showReadings } from "./readings.js";
import { onSelect, selected } from "./selection.js";
import { showSummary } from "./summary.js";
import { onChange, take } from "./store.js";

const AGAIN = 1000; // milliseconds until a stream that the browser has given up is opened again
let stream = null;

/**
 * Open the stream of changes, with the log of the chosen node; the browser opens a lost one again.
 *
 * Browsers open at most six connections to a server. A page in the background holds none: it gets
 * everything every few seconds.
 */
function connect() {
  stream?.close();
  const words = new URLSearchParams();
  if (document.hidden) words.set("behind", "yes");
  else if (selected()) words.set("follow", selected());
  stream = new EventSource(`live?${words}`);
  stream.addEventListener("open", () => document.body.classList.remove("lost"));
  stream.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    if (message.log) takeLines(message.log);
    else take(message);
  });
  stream.addEventListener("error", () => {
    if (document.hidden && stream.readyState === EventSource.CONNECTING) return;
    document.body.classList.add("lost");
    setText(byId("banner"), "No connection to rigel ui: it has ended, or its machine is away. This page tries again.");
    if (stream.readyState === EventSource.CLOSED) setTimeout(connect, AGAIN);
  });
}

onSelect(connect);
onSelect(showLog);
document.addEventListener("visibilitychange", connect);
for (const show of [showSummary, showGraph, showNodes, showDetails, showReadings, showHistory]) onChange(show);
connect();
