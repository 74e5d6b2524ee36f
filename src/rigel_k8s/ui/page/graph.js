// The picture of the ROS graph: nodes on their machines, topics between them. Every node is a
// button: Tab leads to the graph, arrow keys from node to node, Enter chooses one.

import { byId, draw, make, setText, showTime, update } from "./dom.js";
import { matches, finding, onFind } from "./find.js";
import { FONTS, begin, fit, place, route } from "./layout.js";
import { onSelect, select, selected } from "./selection.js";
import { drawState, wordsOf } from "./states.js";
import { get, group } from "./store.js";

const MARGIN = 12;
const area = byId("graph");
let zoom = 0; // 0: as wide as the page, but never too small to read
let drawn = null; // {key, svg, boxes: name -> element, edges, width, height}
let current = ""; // the box that Tab leads to

/** Show what has changed. */
export function showGraph(groups) {
  if (groups && !["node", "box", "topic", "graph", "problems"].some((name) => groups.has(name))) return;
  const boxes = group("box").sort((a, b) => a.name.localeCompare(b.name));
  const topics = group("topic").sort((a, b) => a.name.localeCompare(b.name));
  const key = JSON.stringify([
    Math.floor(area.clientWidth / 80),
    boxes.map((box) => [box.name, box.machine]),
    topics.map((topic) => [topic.name, topic.from, topic.to]),
  ]);
  if (drawn?.key !== key) drawAll(key, boxes, topics);
  for (const box of boxes) colorBox(box);
  for (const topic of topics) colorTopic(topic);
  mark();
  showNotes(boxes);
}

function drawAll(key, boxes, topics) {
  const focused = area.contains(document.activeElement) && document.activeElement.dataset?.box;
  const room = Math.max(area.clientWidth - 2 * MARGIN, 320);
  const placed = place(boxes, topics, room);
  const machines = draw("g", {});
  for (const machine of placed.machines) {
    machines.append(
      draw("g", { class: "machine", "data-machine": machine.name },
        draw("rect", { x: machine.x, y: machine.y, width: machine.width, height: machine.height, rx: 10 }),
        draw("text", { x: machine.x + 14, y: machine.y + 19 }, machine.name)),
    );
  }
  const lines = draw("g", { class: "edges" });
  const pills = draw("g", {});
  const edges = [];
  const found = new Map();
  for (const topic of topics) {
    const at = placed.places.get(`topic ${topic.name}`);
    if (!at) continue;
    const own = `topic ${topic.name}`;
    const ends = [...topic.from.map((name) => [name, true]), ...topic.to.map((name) => [name, false])];
    for (const [name, out] of ends) {
      const box = `box ${name}`;
      if (!placed.places.has(box)) continue;
      const d = out ? route(placed, box, own) : route(placed, own, box);
      const path = draw("path", { class: "edge", d, "marker-end": out ? null : "url(#arrow)" });
      edges.push({ path, node: name, topic: topic.name });
      lines.append(path);
    }
    const pill = draw("g", { class: "topic", "data-topic": topic.name, "aria-hidden": "true" },
      draw("rect", { x: at.x - at.width / 2, y: at.y - at.height / 2, width: at.width, height: at.height, rx: at.height / 2 }),
      draw("text", { x: at.x, y: at.y + 4 }),
      draw("title", {}));
    pill.addEventListener("pointerenter", () => point({ topic: topic.name }));
    pill.addEventListener("pointerleave", () => point(null));
    pills.append(pill);
    found.set(topic.name, { element: pill, room: at.width - 14 });
  }
  const cards = draw("g", { role: "list", "aria-label": "Nodes of the ROS graph" });
  const known = new Map();
  for (const box of boxes) {
    const at = placed.places.get(`box ${box.name}`);
    const card = drawBox(box, at);
    cards.append(draw("g", { role: "listitem" }, card.element));
    known.set(box.name, card);
  }
  const width = placed.width + 2 * MARGIN;
  const height = placed.height + 2 * MARGIN;
  const arrow = draw("marker", { id: "arrow", viewBox: "0 0 8 8", refX: 8, refY: 4, markerWidth: 7, markerHeight: 7, orient: "auto" }, draw("path", { d: "M0 0 8 4 0 8Z" }));
  const svg = draw("svg", { viewBox: `${-MARGIN} ${-MARGIN} ${width} ${height}`, role: "group", "aria-labelledby": "graph-title" }, draw("defs", {}, arrow), machines, lines, pills, cards);
  drawn = { key, svg, boxes: known, topics: found, edges, width, height, order: boxes.map((box) => box.name) };
  if (!known.has(current)) current = boxes[0]?.name ?? "";
  area.replaceChildren(boxes.length ? svg : make("p", { class: "note" }, "No node yet."));
  scale();
  if (focused && known.has(focused)) known.get(focused).element.focus({ preventScroll: true });
}

function drawBox(box, at) {
  const left = at.x - at.width / 2;
  const top = at.y - at.height / 2;
  const shape = draw("g", { transform: `translate(${left + 12} ${top + 8})` });
  const name = draw("text", { class: "name", x: left + 30, y: top + 19 }, `${fit(box.name, FONTS.box, at.width - 38)} `);
  const note = draw("text", { class: "words", x: left + 12, y: top + 36 });
  const title = draw("title", {});
  const element = draw("g", { class: "box", role: "button", tabindex: -1, "data-box": box.name, "data-workload": box.workload },
    draw("rect", { x: left, y: top, width: at.width, height: at.height, rx: 7 }), shape, name, note, title);
  element.addEventListener("click", () => choose(box.name));
  element.addEventListener("focus", () => {
    current = box.name;
    point({ node: box.name });
    mark();
  });
  element.addEventListener("blur", () => point(null));
  element.addEventListener("pointerenter", () => point({ node: box.name }));
  element.addEventListener("pointerleave", () => point(null));
  return { element, shape, note, title, at };
}

/** Give a box the state of its node. */
function colorBox(box) {
  const card = drawn.boxes.get(box.name);
  if (!card) return;
  const node = box.workload ? get(`node/${box.workload}`) : {};
  const state = node.state ?? "outside";
  const words = node.state ? wordsOf(state) : box.note || wordsOf(state);
  const wrong = state === "ready" ? box.wrong : "";
  const brief = node.brief || wrong;
  const cause = node.cause || wrong;
  const description = [`${box.name} ${words}`, brief, cause === brief ? "" : cause, `on ${box.machine}`, ...connections(box.name)];
  const label = description.filter(Boolean).join(", ");
  if (card.shown === label + selected()) return;
  card.shown = label + selected();
  card.element.setAttribute("class", `box ${state}${wrong ? " wrong" : ""}`);
  card.element.setAttribute("aria-label", label);
  card.element.setAttribute("aria-pressed", String(Boolean(box.workload) && box.workload === selected()));
  card.shape.replaceChildren(drawState(state));
  setText(card.note, begin(brief ? `${words}: ${brief}` : words, FONTS.note, card.at.width - 22));
  setText(card.title, label);
}

function connections(name) {
  const topics = group("topic");
  const sent = topics.filter((topic) => topic.from.includes(name)).map((topic) => topic.name).sort();
  const heard = topics.filter((topic) => topic.to.includes(name)).map((topic) => topic.name).sort();
  return [sent.length ? `publishes ${sent.join(" ")}` : "", heard.length ? `subscribes to ${heard.join(" ")}` : ""];
}

function colorTopic(topic) {
  const pill = drawn.topics.get(topic.name);
  if (!pill) return;
  const words = topic.rate ? `${topic.name} ${topic.rate}` : topic.name;
  pill.element.setAttribute("class", `topic${topic.bad ? " bad" : ""}`);
  const [, text, title] = pill.element.children;
  setText(text, fit(words, FONTS.pill, pill.room));
  setText(title, [topic.name, topic.type, topic.rate].filter(Boolean).join(" "));
  for (const edge of drawn.edges) {
    if (edge.topic === topic.name) edge.path.classList.toggle("lost", topic.lost.includes(edge.node));
  }
}

/** Mark what is chosen, what Tab leads to, and what the reader searches for. */
function mark() {
  if (!drawn) return;
  for (const [name, card] of drawn.boxes) {
    card.element.setAttribute("tabindex", name === current ? "0" : "-1");
    card.element.classList.toggle("chosen", Boolean(card.element.dataset.workload) && card.element.dataset.workload === selected());
    card.element.classList.toggle("other", !matches(name, card.element.dataset.workload));
  }
  for (const [name, pill] of drawn.topics) pill.element.classList.toggle("other", !matches(name));
  drawn.svg.classList.toggle("finding", finding());
}

/** Emphasize the connections of a node or topic. */
function point(what) {
  if (!drawn) return;
  drawn.svg.classList.toggle("pointing", Boolean(what));
  const topics = new Set(what?.topic ? [what.topic] : []);
  const nodes = new Set(what?.node ? [what.node] : []);
  for (const edge of drawn.edges) {
    const near = edge.topic === what?.topic || edge.node === what?.node;
    edge.path.classList.toggle("near", near);
    if (near) {
      topics.add(edge.topic);
      nodes.add(edge.node);
    }
  }
  for (const [name, card] of drawn.boxes) card.element.classList.toggle("near", nodes.has(name));
  for (const [name, pill] of drawn.topics) pill.element.classList.toggle("near", topics.has(name));
}

function choose(name) {
  const workload = drawn.boxes.get(name)?.element.dataset.workload;
  if (workload) select(workload);
  mark();
}

function showNotes(boxes) {
  const state = get("graph");
  const read = state.read ? `Topics as of ${showTime(state.read)}.` : "Topics have not been read yet.";
  setText(byId("graph-note"), boxes.length ? `${read}${state.message ? ` ${state.message}.` : ""}` : "");
  const problems = Array.isArray(get("problems")) ? get("problems") : [];
  update(byId("problems"), problems.map((problem) => make("li", { class: problem.severity === "error" ? "wrong" : "doubt" }, problem.message)), problems);
}

// Keys.

const KEYS = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowDown: [0, 1], ArrowUp: [0, -1] };

area.addEventListener("keydown", (event) => {
  const name = event.target.dataset?.box;
  if (!name || event.ctrlKey || event.metaKey || event.altKey) return;
  let next = "";
  if (KEYS[event.key]) next = nearest(name, ...KEYS[event.key]);
  else if (event.key === "Home") next = drawn.order[0];
  else if (event.key === "End") next = drawn.order.at(-1);
  else if (event.key === "Enter" || event.key === " ") choose(name);
  else return;
  event.preventDefault();
  if (next) {
    drawn.boxes.get(next).element.focus({ preventScroll: true });
    drawn.boxes.get(next).element.scrollIntoView({ block: "nearest", inline: "nearest" });
  }
});

/** Return the box that is next in a direction, "" if it is missing. */
function nearest(name, dx, dy) {
  const from = drawn.boxes.get(name).at;
  let best = "";
  let least = Infinity;
  for (const [other, { at }] of drawn.boxes) {
    const along = (at.x - from.x) * dx + (at.y - from.y) * dy;
    const across = Math.abs((at.x - from.x) * dy) + Math.abs((at.y - from.y) * dx);
    if (other !== name && along > 1 && along + 2 * across < least) {
      least = along + 2 * across;
      best = other;
    }
  }
  return best;
}

// Size.

const READABLE = 0.85; // below that, texts of 14 pixels are hard to read

function scale() {
  if (!drawn) return;
  const room = area.clientWidth - 2;
  const factor = zoom || Math.min(1, Math.max(READABLE, room / drawn.width));
  drawn.svg.setAttribute("width", Math.round(drawn.width * factor));
  drawn.svg.setAttribute("height", Math.round(drawn.height * factor));
  drawn.factor = factor;
}

function zoomBy(step) {
  zoom = Math.min(3, Math.max(0.3, (zoom || drawn?.factor || 1) * step));
  scale();
}

byId("zoom-in").addEventListener("click", () => zoomBy(1.25));
byId("zoom-out").addEventListener("click", () => zoomBy(0.8));
byId("zoom-fit").addEventListener("click", () => {
  zoom = drawn && zoom !== area.clientWidth / drawn.width ? (area.clientWidth - 2) / drawn.width : 0;
  scale();
});
new ResizeObserver(() => {
  showGraph();
  scale();
}).observe(area);
onFind(mark);
onSelect(() => showGraph());
