// The list of nodes, those with the worst states first.

import { byId, make, update } from "./dom.js";
import { matches, onFind } from "./find.js";
import { onSelect, select, selected } from "./selection.js";
import { STATES, drawIcon, wordsOf } from "./states.js";
import { group } from "./store.js";

const ORDER = Object.keys(STATES);

/** Show what has changed. */
export function showNodes(groups) {
  if (groups && !groups.has("node")) return;
  const found = group("node").filter((node) => matches(node.name, node.workload, node.machine));
  found.sort((a, b) => ORDER.indexOf(a.state) - ORDER.indexOf(b.state) || a.name.localeCompare(b.name));
  const focused = document.activeElement?.dataset?.node;
  const rows = found.map(makeRow);
  const key = [selected(), ...found.map((n) => [n.name, n.workload, n.state, n.cause, n.machine, n.ready, n.desired, n.restarts])];
  if (update(byId("nodes"), rows, key) && focused) {
    byId("nodes").querySelector(`[data-node="${CSS.escape(focused)}"]`)?.focus();
  }
}

function makeRow(node) {
  const button = make(
    "button",
    {
      type: "button",
      class: "link",
      "data-node": node.workload,
      "aria-pressed": node.workload === selected() ? "true" : "false",
      onclick: () => select(node.workload),
    },
    node.name,
  );
  return make(
    "tr",
    { class: node.state },
    make("td", { class: "state" }, drawIcon(node.state), ` ${wordsOf(node.state)}`),
    make("th", { scope: "row" }, button),
    make("td", {}, node.machine || "–"),
    make("td", { class: "extra" }, `${node.ready}/${node.desired}`),
    make("td", { class: "extra" }, String(node.restarts)),
    make("td", { class: "cause" }, node.cause || "–"),
  );
}

/** Return an image with a short digest. */
export function shorten(image) {
  const [name, digest] = (image || "–").split("@sha256:");
  return digest ? `${name}@sha256:${digest.slice(0, 7)}` : name;
}

onSelect(() => showNodes());
onFind(() => showNodes());
