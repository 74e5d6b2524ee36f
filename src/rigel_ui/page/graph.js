// The picture of the ROS graph: nodes on their machines, topics between them. Each of them is a
// button: Tab leads to the graph, arrow keys from one to the next, Enter chooses one.

import { byId, draw, make, setText, showTime, update } from "./dom.js";
import { matches, finding, onFind } from "./find.js";
import { load, place, scaleIn } from "./graphviz.js";
import { onChoose, select, selected, selectTopic, selectedTopic } from "./selection.js";
import { drawState, wordsOf } from "./states.js";
import { get, group } from "./store.js";
import { begin, squeeze } from "./text.js";

const MARGIN = 6;
const FAMILY = "Helvetica, Arial, sans-serif"; // the widths that Graphviz has
const FONTS = { name: `600 14px ${FAMILY}`, small: `12px ${FAMILY}` };
const area = byId("graph");
let zoom = 0; // 0: the whole graph, but never too small to read
let failure = ""; // why Graphviz does not run here
let drawn = null; // {placed, svg, boxes, topics: by name, items: both by their names in DOT, edges, width, height}
let current = ""; // the item that Tab leads to

/** Show what has changed. */
export function showGraph(groups) {
  if (groups && !["node", "box", "topic", "dot", "graph", "problems"].some((name) => groups.has(name))) return;
  const boxes = group("box").sort((a, b) => a.name.localeCompare(b.name));
  const topics = group("topic").sort((a, b) => a.name.localeCompare(b.name));
  const placed = boxes.length ? place(get("dot").text ?? "", room()) : null;
  if (placed && drawn?.placed !== placed) drawAll(placed, boxes, topics);
  if (!boxes.length) {
    drawn = null;
    showView();
    update(area, [make("p", { class: "note" }, "No node yet.")], "none");
  }
  if (drawn) {
    for (const box of boxes) colorBox(box);
    for (const topic of topics) colorTopic(topic);
    mark();
  }
  showNotes(boxes);
}

/** Return the room in which the whole graph should be. */
const room = () => ({ width: Math.max(area.clientWidth - 2, 240), height: Math.min(innerHeight * 0.72, 960) - 2 });

function drawAll(placed, boxes, topics) {
  const focused = area.contains(document.activeElement) && document.activeElement.dataset.item;
  const machines = draw("g", {});
  for (const machine of placed.machines) {
    machines.append(
      draw("g", { class: "machine", "data-machine": machine.name },
        draw("rect", { x: machine.x, y: machine.y, width: machine.width, height: machine.height, rx: 10 }),
        draw("text", { x: machine.x + 10, y: machine.y + 18 }, machine.name)),
    );
  }
  const lines = draw("g", { class: "edges" });
  const edges = placed.edges.map(({ from, to, d }) => {
    const path = draw("path", { class: "edge", d, "marker-end": "url(#arrow)", "data-from": from, "data-to": to });
    lines.append(path);
    const [node, topic] = from.startsWith("node ") ? [from, to] : [to, from];
    return { path, node: node.slice("node ".length), topic: topic.slice("topic ".length) };
  });
  const pills = draw("g", { role: "list", "aria-label": "Topics of the ROS graph" });
  const found = new Map();
  for (const topic of topics) {
    const at = placed.places.get(`topic ${topic.name}`);
    if (!at) continue;
    const pill = draw("g", { "data-topic": topic.name },
      draw("rect", { x: at.x - at.width / 2, y: at.y - at.height / 2, width: at.width, height: at.height, rx: at.height / 2 }),
      draw("text", { class: "name", x: at.x, y: at.y - 3 }),
      draw("text", { x: at.x, y: at.y + 13 }),
      draw("title", {}));
    makeButton(pill, `topic ${topic.name}`, { topic: topic.name });
    pills.append(draw("g", { role: "listitem" }, pill));
    found.set(topic.name, { element: pill, room: at.width - 12, at });
  }
  const cards = draw("g", { role: "list", "aria-label": "Nodes of the ROS graph" });
  const known = new Map();
  for (const box of boxes) {
    const at = placed.places.get(`node ${box.name}`);
    if (!at) continue;
    const card = drawBox(box, at);
    cards.append(draw("g", { role: "listitem" }, card.element));
    known.set(box.name, card);
  }
  const width = placed.width + 2 * MARGIN;
  const height = placed.height + 2 * MARGIN;
  const arrow = draw("marker", { id: "arrow", viewBox: "0 0 8 8", refX: 8, refY: 4, markerWidth: 7, markerHeight: 7, orient: "auto" }, draw("path", { d: "M0 0 8 4 0 8Z" }));
  const svg = draw("svg", { viewBox: `${-MARGIN} ${-MARGIN} ${width} ${height}`, role: "group", "aria-labelledby": "graph-title" }, draw("defs", {}, arrow), machines, lines, pills, cards);
  const order = [...known.keys()].map((name) => `node ${name}`);
  const items = new Map([...known, ...found].map(([, item]) => [item.element.dataset.item, item]));
  drawn = { placed, svg, boxes: known, topics: found, items, edges, width, height, order };
  if (!items.has(current)) current = order[0] ?? "";
  update(area, [svg]);
  scale();
  if (focused) items.get(focused)?.element.focus({ preventScroll: true });
}

function drawBox(box, at) {
  const left = at.x - at.width / 2;
  const top = at.y - at.height / 2;
  const shape = draw("g", { transform: `translate(${left + 10} ${top + 8})` });
  const name = draw("text", { class: "name", x: left + 27, y: top + 19 });
  squeeze(name, `${box.name} `, FONTS.name, at.width - 36);
  const note = draw("text", { class: "words", x: left + 10, y: top + 36 });
  const title = draw("title", {});
  const element = draw("g", { class: "box", "data-box": box.name, "data-workload": box.workload },
    draw("rect", { x: left, y: top, width: at.width, height: at.height, rx: 7 }), shape, name, note, title);
  makeButton(element, `node ${box.name}`, { node: box.name });
  return { element, shape, note, title, at };
}

/** Make a button of a node or topic; `what` is emphasized while the reader points at it. */
function makeButton(element, item, what) {
  element.dataset.item = item;
  element.setAttribute("role", "button");
  element.addEventListener("click", () => choose(item));
  element.addEventListener("focus", () => {
    current = item;
    point(what);
    mark();
  });
  element.addEventListener("blur", () => point(null));
  element.addEventListener("pointerenter", () => point(what));
  element.addEventListener("pointerleave", () => point(null));
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
  setText(card.note, begin(brief ? `${words}: ${brief}` : words, FONTS.small, card.at.width - 18));
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
  pill.element.setAttribute("class", `topic${topic.bad ? " bad" : ""}`);
  const ends = [topic.from.length ? `from ${topic.from.join(" ")}` : "", topic.to.length ? `to ${topic.to.join(" ")}` : ""];
  const label = [`${topic.name} ${topic.rate || "–"}`, topic.type ? `topic of type ${topic.type}` : "topic", ...ends].filter(Boolean).join(", ");
  pill.element.setAttribute("aria-label", label);
  const [, name, rate, title] = pill.element.children;
  squeeze(name, `${topic.name} `, FONTS.small, pill.room);
  setText(rate, topic.rate || "–");
  setText(title, label);
  for (const edge of drawn.edges) {
    if (edge.topic === topic.name) edge.path.classList.toggle("lost", topic.lost.includes(edge.node));
  }
}

/** Mark what is chosen, what Tab leads to, and what the reader searches for. */
function mark() {
  if (!drawn) return;
  for (const [name, card] of drawn.boxes) {
    card.element.classList.toggle("chosen", Boolean(card.element.dataset.workload) && card.element.dataset.workload === selected());
    card.element.classList.toggle("other", !matches(name, card.element.dataset.workload));
  }
  for (const [name, pill] of drawn.topics) {
    pill.element.setAttribute("aria-pressed", String(name === selectedTopic()));
    pill.element.classList.toggle("chosen", name === selectedTopic());
    pill.element.classList.toggle("other", !matches(name));
  }
  for (const [item, { element }] of drawn.items) element.setAttribute("tabindex", item === current ? "0" : "-1");
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

function choose(item) {
  const { topic, workload } = drawn.items.get(item).element.dataset;
  if (topic) selectTopic(topic);
  else if (workload) select(workload);
}

function showNotes(boxes) {
  const state = get("graph");
  const read = state.read ? `Topics as of ${showTime(state.read)}.` : "Topics have not been read yet.";
  const notes = [read, state.message && `${state.message}.`, failure].filter(Boolean);
  setText(byId("graph-note"), boxes.length ? notes.join(" ") : "");
  const problems = Array.isArray(get("problems")) ? get("problems") : [];
  update(byId("problems"), problems.map((problem) => make("li", { class: problem.severity === "error" ? "wrong" : "doubt" }, problem.message)), problems);
}

// Keys.

const KEYS = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowDown: [0, 1], ArrowUp: [0, -1] };

area.addEventListener("keydown", (event) => {
  const item = event.target.dataset?.item;
  if (!item || event.ctrlKey || event.metaKey || event.altKey) return;
  let next = "";
  if (KEYS[event.key]) next = nearest(item, ...KEYS[event.key]);
  else if (event.key === "Home") next = drawn.order[0];
  else if (event.key === "End") next = drawn.order.at(-1);
  else if (event.key === "Enter" || event.key === " ") choose(item);
  else return;
  event.preventDefault();
  if (next) {
    drawn.items.get(next).element.focus({ preventScroll: true });
    drawn.items.get(next).element.scrollIntoView({ block: "nearest", inline: "nearest" });
  }
});

/** Return the node or topic that is next in a direction, "" if it is missing. */
function nearest(item, dx, dy) {
  const from = drawn.items.get(item).at;
  let best = "";
  let least = Infinity;
  for (const [other, { at }] of drawn.items) {
    const along = (at.x - from.x) * dx + (at.y - from.y) * dy;
    const across = Math.abs((at.x - from.x) * dy) + Math.abs((at.y - from.y) * dx);
    if (other !== item && along > 1 && along + 2 * across < least) {
      least = along + 2 * across;
      best = other;
    }
  }
  return best;
}

// Size.

const READABLE = 0.85; // below that, texts of 12 pixels are hard to read
const LEAST = 0.6; // a graph that is readable with some effort is shown whole
const LARGEST = 1.4;

function scale() {
  if (!drawn) return;
  const whole = Math.min(LARGEST, scaleIn(drawn, room()));
  const wide = Math.min(1, Math.max(READABLE, room().width / drawn.width));
  drawn.factor = zoom || (whole < LEAST ? wide : whole);
  drawn.svg.setAttribute("width", Math.floor(drawn.width * drawn.factor));
  drawn.svg.setAttribute("height", Math.floor(drawn.height * drawn.factor));
  showView();
}

/** Show how many nodes are in view, unless all are. */
function showView() {
  const view = area.getBoundingClientRect();
  const boxes = [...(drawn?.boxes.values() ?? [])].map(({ element }) => element.getBoundingClientRect());
  const seen = boxes.filter((box) => box.left >= view.left && box.right <= view.right && box.top >= view.top && box.bottom <= view.bottom);
  setText(byId("graph-view"), seen.length < boxes.length ? `${seen.length} of ${boxes.length} nodes are in view` : "");
}

function zoomBy(step) {
  zoom = Math.min(3, Math.max(0.3, (drawn?.factor ?? 1) * step));
  scale();
}

byId("zoom-in").addEventListener("click", () => zoomBy(1.25));
byId("zoom-out").addEventListener("click", () => zoomBy(0.8));
byId("zoom-fit").addEventListener("click", () => {
  const whole = drawn ? scaleIn(drawn, room()) : 0;
  zoom = zoom === whole ? 0 : whole;
  scale();
});
area.addEventListener("scroll", showView);
new ResizeObserver(() => {
  showGraph();
  scale();
}).observe(area);
onFind(mark);
onChoose(() => showGraph());
load((message) => {
  failure = message;
  showGraph();
});
