// The states of a node: their words, and a shape for each, since color alone is not enough.

import { draw } from "./dom.js";

export const STATES = {
  crashed: { words: "crashed", path: "M2 2 10 10 M10 2 2 10", line: true },
  blocked: { words: "cannot start", path: "M2 2H10V10H2Z" },
  unreachable: { words: "machine unreachable", path: "M6 1A5 5 0 1 1 5.9 1 M2.5 9.5 9.5 2.5", line: true },
  outdated: { words: "update failed", path: "M6 0.5 11.5 6 6 11.5 0.5 6Z M6 4V8", line: true },
  unready: { words: "not ready", path: "M6 1 11 11H1Z" },
  starting: { words: "starting", path: "M6 1A5 5 0 0 1 6 11Z", ring: true },
  stopped: { words: "stopped", path: "M2 2H5V10H2Z M7 2H10V10H7Z" },
  done: { words: "done", path: "M2 6.5 5 9.5 10.5 2.5", line: true },
  ready: { words: "ready", path: "M6 1A5 5 0 1 1 5.9 1" },
  outside: { words: "outside the release", path: "M6 1.5A4.5 4.5 0 1 1 5.9 1.5", line: true },
};

/** Return the words of a state. */
export const wordsOf = (state) => (STATES[state] ?? STATES.outside).words;

/** Return a state's shape, 12 by 12. */
export function drawState(state, attributes = {}) {
  const known = STATES[state] ?? STATES.outside;
  const path = draw("path", { class: `shape ${known.line ? "line" : "full"}`, d: known.path });
  const ring = known.ring ? draw("circle", { class: "shape ring", cx: 6, cy: 6, r: 4.5 }) : null;
  return draw("g", attributes, path, ring);
}

/** Return a state's shape as a picture of its own, for lists. */
export function drawIcon(state) {
  return draw(
    "svg",
    { class: `icon ${state}`, viewBox: "0 0 12 12", width: 12, height: 12, "aria-hidden": "true" },
    drawState(state),
  );
}
