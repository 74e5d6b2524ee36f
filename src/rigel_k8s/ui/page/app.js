// The page: its connection to the server, and the parts that show what it receives.

import { byId, setText } from "./dom.js";
import { showDetails } from "./details.js";
import { showGraph } from "./graph.js";
import { showHistory } from "./history.js";
import { showLog, takeLines } from "./log.js";
import { showNodes } from "./nodes.js";
import { onSelect, selected } from "./selection.js";
import { showSummary } from "./summary.js";
import { onChange, take } from "./store.js";

const AGAIN = 1000; // milliseconds before a lost connection is tried again
let socket = null;

function connect() {
  const address = new URL("live", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  socket = new WebSocket(address);
  socket.addEventListener("open", () => {
    document.body.classList.remove("lost");
    follow();
  });
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    if (message.log) takeLines(message.log);
    else take(message);
  });
  socket.addEventListener("close", () => {
    socket = null;
    document.body.classList.add("lost");
    setText(byId("banner"), "No connection to rigel ui: it has ended, or its machine is away. This page tries again.");
    setTimeout(connect, AGAIN);
  });
}

/** Request the log of the chosen node. */
function follow() {
  if (socket?.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify({ follow: selected() || null }));
  }
}

onSelect(follow);
onSelect(showLog);
for (const show of [showSummary, showGraph, showNodes, showDetails, showHistory]) onChange(show);
connect();
