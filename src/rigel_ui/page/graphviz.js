// Places by Graphviz, in the browser. The server describes the graph in DOT, as `rigel graph` does,
// by names only: when a state changes, nothing moves.

import { instance } from "./lib/viz.js";

const POINTS = 72; // in an inch
let viz = null;
let known = { dot: "" }; // places by direction: {dot, LR, TB}

/** Load Graphviz, and call a function then, or with what keeps it from running here. */
export function load(call) {
  instance().then((made) => {
    viz = made;
    call("");
  }).catch((error) => call(`This browser cannot draw the graph: ${error.message}`));
}

/**
 * Return places {width, height, machines, places, edges} in points, null before Graphviz is loaded.
 *
 * A graph grows from left to right, or from top to bottom if it is then larger in the room.
 */
export function place(dot, room) {
  if (!viz) return null;
  if (known.dot !== dot) known = { dot, LR: read(dot, "LR") };
  if (known.LR.width <= room.width) return known.LR;
  known.TB ??= read(dot, "TB");
  return scaleIn(known.TB, room) > scaleIn(known.LR, room) ? known.TB : known.LR;
}

/** Return by which factor places fill a room. */
export const scaleIn = (placed, room) => Math.min(room.width / placed.width, room.height / placed.height);

function read(dot, direction) {
  const found = JSON.parse(viz.renderString(dot.replace("rankdir=LR", `rankdir=${direction}`), { format: "json0" }));
  const [, , width, height] = numbers(found.bb);
  const placed = { width, height, machines: [], places: new Map(), edges: [] };
  const names = new Map();
  for (const item of found.objects ?? []) {
    const name = decodeURIComponent(item.name);
    names.set(item._gvid, name);
    if (item.bb) {
      const [left, low, right, high] = numbers(item.bb);
      placed.machines.push({ name: item.label, x: left, y: height - high, width: right - left, height: high - low });
    } else {
      const [x, y] = numbers(item.pos);
      placed.places.set(name, { x, y: height - y, width: item.width * POINTS, height: item.height * POINTS });
    }
  }
  for (const edge of found.edges ?? []) {
    placed.edges.push({ from: names.get(edge.tail), to: names.get(edge.head), d: trace(edge.pos, height) });
  }
  return placed;
}

const numbers = (text) => text.split(",").map(Number);

/** Return the path of an edge: "e,TIP" and the points of curves. */
function trace(pos, height) {
  const points = pos.split(" ");
  const tip = points[0].startsWith("e,") ? points.shift().slice(2) : points.at(-1);
  const [start, ...curve] = points.map((point) => flip(point, height));
  return `M${start}C${curve.join(" ")}L${flip(tip, height)}`;
}

function flip(point, height) {
  const [x, y] = numbers(point);
  return `${x} ${height - y}`;
}
