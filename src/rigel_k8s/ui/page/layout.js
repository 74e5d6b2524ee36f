// Places boxes, topics and machines by dagre, from their names and connections only: when a state
// changes, nothing moves.

import { Graph, layout } from "./lib/dagre.js";

export const BOX = { height: 44, least: 176, most: 280 };
export const PILL = { height: 22, least: 40, most: 240 };
const HEAD = 26; // room for a machine's name
const GAP = 28; // between two machines
const measure = document.createElement("canvas").getContext("2d");

/** Return how wide a text is. */
function widthOf(text, font) {
  measure.font = font;
  return Math.ceil(measure.measureText(text).width);
}

/** Return a text that is no wider than this, shortened in its middle. */
export function fit(text, font, room) {
  if (widthOf(text, font) <= room) return text;
  for (let kept = text.length - 1; kept > 2; kept -= 1) {
    const head = Math.ceil(kept / 2);
    const short = `${text.slice(0, head)}…${text.slice(text.length - (kept - head))}`;
    if (widthOf(short, font) <= room) return short;
  }
  return "…";
}

/** Return the first words of a text, as many as fit; a parenthesis is whole or left out. */
export function begin(text, font, room) {
  if (widthOf(text, font) <= room) return text;
  const words = text.split(" ");
  while (words.length > 1) {
    words.pop();
    const left = words.join(" ").replace(/ ?\([^)]*$/, "");
    if (widthOf(`${left} …`, font) <= room) return `${left} …`;
  }
  return fit(text, font, room);
}

export const FONTS = { box: "600 14px system-ui, sans-serif", note: "12px system-ui, sans-serif", pill: "12px system-ui, sans-serif" };
export const clamp = (value, least, most) => Math.min(Math.max(value, least), most);

/**
 * Return places: of machines {name, x, y, width, height}, of boxes and topics {x, y, width,
 * height} by their centers, and the points of edges.
 *
 * Each machine is laid out separately, and the machines are put in rows as wide as the page: a
 * hundred nodes stay as large as ten.
 */
export function place(boxes, topics, room) {
  const home = new Map(boxes.map((box) => [box.name, box.machine]));
  const machines = [...new Set(boxes.map((box) => box.machine))].sort(byName);
  const owner = (topic) => {
    const ends = (topic.from.length ? topic.from : topic.to).filter((name) => home.has(name));
    return ends.length ? home.get(ends[0]) : "";
  };
  const placeAll = (direction) =>
    machines.map((machine) =>
      placeMachine(
        machine,
        boxes.filter((box) => box.machine === machine),
        topics.filter((topic) => owner(topic) === machine),
        room,
        direction,
      ),
    );
  let direction = "LR";
  let parts = placeAll(direction);
  if (parts.some((part) => part.width > room)) {
    direction = "TB"; // a page can grow in height, but not in width
    parts = placeAll(direction);
  }
  return { ...putInRows(parts, room), direction };
}

const OUTSIDE = ["outside the release", "on no machine"];
const byName = (a, b) => OUTSIDE.indexOf(a) - OUTSIDE.indexOf(b) || a.localeCompare(b, undefined, { numeric: true });

function placeMachine(machine, boxes, topics, room, direction) {
  const graph = new Graph({ multigraph: true });
  const ranksep = direction === "LR" ? 42 : 24;
  graph.setGraph({ rankdir: direction, nodesep: 12, edgesep: 8, ranksep, marginx: 14, marginy: 12 });
  graph.setDefaultEdgeLabel(() => ({}));
  for (const box of boxes) graph.setNode(`box ${box.name}`, sizeOfBox(box));
  for (const topic of topics) graph.setNode(`topic ${topic.name}`, sizeOfPill(topic));
  for (const topic of topics) {
    for (const name of topic.from) {
      if (graph.hasNode(`box ${name}`)) graph.setEdge(`box ${name}`, `topic ${topic.name}`);
    }
    for (const name of topic.to) {
      if (graph.hasNode(`box ${name}`)) graph.setEdge(`topic ${topic.name}`, `box ${name}`);
    }
  }
  wrapLoose(graph, room, direction);
  layout(graph);
  const places = new Map(graph.nodes().map((name) => [name, graph.node(name)]));
  const routes = new Map(graph.edges().map((edge) => [`${edge.v}|${edge.w}`, graph.edge(edge).points]));
  const size = graph.graph();
  const title = widthOf(machine, FONTS.box) + 28;
  return { machine, places, routes, width: Math.max(size.width || 0, title), height: (size.height || 0) + HEAD };
}

/** Give nodes without any connection on this machine a place in columns, not one long column. */
function wrapLoose(graph, room, direction) {
  const loose = graph.nodes().filter((name) => graph.nodeEdges(name).length === 0);
  const columns = clamp(Math.ceil(Math.sqrt(loose.length / 3)), 1, Math.max(1, Math.floor(room / 320)));
  const rank = direction === "LR" ? Math.ceil(loose.length / columns) : columns;
  loose.forEach((name, i) => {
    if (i >= rank) graph.setEdge(loose[i - rank], name, { weight: 0 }, "column");
  });
}

export function sizeOfBox(box) {
  const name = widthOf(box.name, FONTS.box) + 40;
  return { width: clamp(name, BOX.least, BOX.most), height: BOX.height };
}

export function sizeOfPill(topic) {
  // With room for any rate, so that nothing moves when a rate changes.
  const words = `${topic.name} 9999/s`;
  return { width: clamp(widthOf(words, FONTS.pill) + 18, PILL.least, PILL.most), height: PILL.height };
}

/** Put machines side by side, in a new row if there is no more room. */
function putInRows(parts, room) {
  const machines = [];
  const places = new Map();
  const routes = new Map();
  let x = 0;
  let y = 0;
  let tallest = 0;
  let width = 0;
  for (const part of parts) {
    if (x > 0 && x + part.width > room) {
      x = 0;
      y += tallest + GAP;
      tallest = 0;
    }
    machines.push({ name: part.machine, x, y, width: part.width, height: part.height });
    for (const [name, at] of part.places) {
      places.set(name, { x: x + at.x, y: y + HEAD + at.y, width: at.width, height: at.height });
    }
    for (const [name, points] of part.routes) {
      routes.set(name, points.map((at) => ({ x: x + at.x, y: y + HEAD + at.y })));
    }
    x += part.width + GAP;
    width = Math.max(width, x - GAP);
    tallest = Math.max(tallest, part.height);
  }
  return { machines, places, routes, width, height: y + tallest };
}

/** Return the path of an edge: on a machine as it was laid out, between machines as a bow. */
export function route(placed, start, end) {
  const points = placed.routes.get(`${start}|${end}`);
  const [from, to] = [placed.places.get(start), placed.places.get(end)];
  if (points) return smooth(points);
  const sides = placed.direction === "TB" ? ["y", "height", "x", "width"] : ["x", "width", "y", "height"];
  return bow(placed, from, to, sides);
}

/** Return a bow from one machine to another: along the direction, or around the side, and back. */
function bow(placed, from, to, [main, length, cross, breadth]) {
  const start = from[main] + from[length] / 2;
  const end = to[main] - to[length] / 2;
  const at = (along, across) => (main === "x" ? `${along} ${across}` : `${across} ${along}`);
  if (end > start) {
    const bend = clamp((end - start) / 2, 20, 90);
    return `M${at(start, from[cross])}C${at(start + bend, from[cross])} ${at(end - bend, to[cross])} ${at(end, to[cross])}`;
  }
  const [near, far] = [from[cross] + from[breadth] / 2, to[cross] + to[breadth] / 2];
  const out = Math.max(near, far) + clamp(Math.abs(from[main] - to[main]) / 6, 24, 90);
  placed[breadth] = Math.max(placed[breadth], Math.max(near, far) / 4 + (out * 3) / 4 + 4);
  return `M${at(from[main], near)}C${at(from[main], out)} ${at(to[main], out)} ${at(to[main], far)}`;
}

/** Return a line through points whose corners are round. */
function smooth(points) {
  const [first, ...rest] = points;
  const last = rest.pop() ?? first;
  let path = `M${first.x} ${first.y}`;
  rest.forEach((point, i) => {
    const next = rest[i + 1] ?? last;
    path += `Q${point.x} ${point.y} ${(point.x + next.x) / 2} ${(point.y + next.y) / 2}`;
  });
  return `${path}L${last.x} ${last.y}`;
}
