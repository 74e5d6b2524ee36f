// The log of the chosen node, as it arrives.

import { byId, make, setText, showTime } from "./dom.js";
import { selected } from "./selection.js";
import { get } from "./store.js";

const MOST = 1000; // lines that the page keeps
const LEVELS = ["debug", "info", "warn", "error", "fatal"];
const area = byId("log");
let paused = false;
let held = []; // lines that came during a pause
let again = false; // whether they replace the lines that are shown

/** Begin with another node. */
export function showLog() {
  clear();
  const name = selected() && (get(`node/${selected()}`).name ?? selected());
  setText(byId("log-title"), name ? `Log of ${name}` : "Log");
  setText(byId("log-note"), name ? "" : "Choose a node to follow its log.");
  area.hidden = !name;
}

function clear() {
  area.replaceChildren();
  held = [];
  again = false;
}

/** Take lines from the server. */
export function takeLines({ node, begins, lines }) {
  if (node !== selected()) return;
  if (paused) {
    held = [...(begins ? [] : held), ...lines].slice(-MOST);
    again ||= begins;
    setText(byId("log-note"), `Paused: ${held.length} new lines.`);
    return;
  }
  if (begins) clear();
  const atEnd = area.scrollHeight - area.scrollTop - area.clientHeight < 40;
  area.append(...lines.map(makeLine));
  while (area.childElementCount > MOST) area.firstElementChild.remove();
  if (atEnd) area.scrollTop = area.scrollHeight;
}

// What ROS writes before a message: a level, the time that Kubernetes has as well, a logger.
const PREFIX = /^(?:\x1b\[[\d;]*m)*\[\s*([A-Z]+)\] ?\[\d+\.\d+\](?: \[([^\]]+)\])?: /;

function makeLine([time, level, pod, text, note]) {
  const line = make("div", { class: `line ${note ? "ours" : level}`, title: pod || null });
  line.dataset.level = level;
  if (time) line.append(make("time", { datetime: time }, `${showTime(`${time.slice(0, 23)}Z`)}.${time.slice(20, 23)}`), " ");
  const head = time ? PREFIX.exec(text) : null;
  line.append(head ? `${head[1]} ${head[2] ? `${head[2]}: ` : ""}${text.slice(head[0].length)}` : text);
  line.hidden = !isShown(line);
  return line;
}

function isShown(line) {
  const least = LEVELS.indexOf(byId("level").value);
  const wanted = byId("filter").value.toLowerCase();
  return LEVELS.indexOf(line.dataset.level) >= least && line.textContent.toLowerCase().includes(wanted);
}

function filter() {
  for (const line of area.children) line.hidden = !isShown(line);
  area.scrollTop = area.scrollHeight;
}

byId("level").addEventListener("change", filter);
byId("filter").addEventListener("input", filter);
byId("pause").addEventListener("click", (event) => {
  paused = !paused;
  event.currentTarget.setAttribute("aria-pressed", String(paused));
  setText(event.currentTarget, paused ? "Continue" : "Pause");
  if (paused) return;
  setText(byId("log-note"), "");
  takeLines({ node: selected(), begins: again, lines: held.splice(0) });
});
showLog();
