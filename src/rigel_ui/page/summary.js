// The head of the page: which release, how many nodes are in which state, the roll-out.

import { byId, make, setText, showTime, update } from "./dom.js";
import { STATES, drawIcon, wordsOf } from "./states.js";
import { get, group, has } from "./store.js";

let before = new Map();
let seen = null; // how a rollback ended that is not shown: the reader has closed it, or it was done before

/** Show what has changed. */
export function showSummary() {
  const cluster = get("cluster");
  const release = get("release");
  setText(byId("release"), cluster.release ?? "rigel ui");
  setText(byId("place"), cluster.namespace ? `namespace ${cluster.namespace}, context ${cluster.context || "of this pod"}` : "");
  setText(byId("revision"), describeRevision(release));
  showBanner(cluster, release);
  showCounts(release);
  showRollout(release);
  showChange(get("change"));
  announce();
  const wrong = (release.counts?.crashed ?? 0) + (release.counts?.blocked ?? 0) + (release.counts?.unreachable ?? 0);
  const name = cluster.release ?? "rigel ui";
  document.title = wrong ? `✖ ${wrong} · ${name}` : name;
}

function describeRevision(release) {
  if (!release.revision) return release.status === "unseen" ? "Revisions cannot be seen without the right to watch Secrets." : "";
  const words = { pending: isRolling(release) ? "being rolled out" : "interrupted", unseen: "" };
  const state = words[release.status] ?? release.status;
  return `Revision ${release.revision}${state ? `, ${state}` : ""}`;
}

/** Return whether a deploy is in progress. */
export const isRolling = (release) => release.status === "pending" && release.changing !== "";

function showBanner(cluster, release) {
  document.body.classList.toggle("stale", Boolean(cluster.message));
  if (document.body.classList.contains("lost")) return;
  let text = "";
  if (cluster.message) {
    const old = has("release") ? ` What this page shows is of ${showTime(cluster.since)}.` : "";
    text = `${cluster.message}.${old}`;
  } else if (release.absent) {
    text = `There is no release ${cluster.release} in the namespace ${cluster.namespace} yet. This page waits for it.`;
  } else if (release.missing?.length) {
    text = release.missing.join("; ");
  }
  setText(byId("banner"), text);
}

function showCounts(release) {
  const counts = Object.keys(STATES).filter((state) => release.counts?.[state]);
  const items = counts.map((state) =>
    make("li", { class: state, title: wordsOf(state) }, drawIcon(state), ` ${release.counts[state]}`, make("span", {}, ` ${wordsOf(state)}`)),
  );
  if (update(byId("counts"), items, release.counts ?? {})) fitCounts();
}

/** Leave the words out, except for screen readers, where they have no room. */
function fitCounts() {
  const part = byId("counts");
  const hide = (hidden) => part.querySelectorAll("span").forEach((words) => words.classList.toggle("hidden", hidden));
  hide(false);
  hide(part.scrollWidth > part.clientWidth);
}

new ResizeObserver(fitCounts).observe(byId("counts"));

function showRollout(release) {
  const part = byId("rollout");
  part.hidden = !isRolling(release);
  if (part.hidden) return;
  const by = release.changing ? `, rolled out by ${release.changing}` : "";
  setText(byId("rollout-text"), `${release.ready} of ${release.nodes} nodes are ready${by}`);
  byId("rollout-bar").max = Math.max(release.nodes, 1);
  byId("rollout-bar").value = release.ready;
}

function showChange(change) {
  const part = byId("change");
  if (has("cluster")) seen ??= change.state === "done" ? change.message : "";
  part.hidden = !change.state || (change.state !== "running" && change.message === seen);
  if (part.hidden) return;
  byId("change-close").hidden = change.state === "running";
  const words = { running: `Rolling back to revision ${change.to} …`, done: `Rolled back: ${change.message}`, failed: `The rollback failed: ${change.message}` };
  part.className = change.state;
  setText(byId("change-text"), words[change.state]);
  setText(byId("change-lines"), change.lines.join("\n"));
  byId("change-lines").hidden = change.lines.length === 0;
}

/** Let screen readers announce which nodes have changed their state. */
function announce() {
  const now = new Map(group("node").map((node) => [node.name, node]));
  const news = [];
  for (const [name, node] of now) {
    const old = before.get(name);
    if (before.size && old?.state !== node.state) {
      const cause = ["ready", "starting"].includes(node.state) ? "" : `: ${node.cause}`;
      news.push(`${name} is ${wordsOf(node.state)}${cause}`);
    }
  }
  before = now;
  if (news.length > 4) setText(byId("announcer"), `${news.length} nodes have changed`);
  else if (news.length) setText(byId("announcer"), news.join(". "));
}

byId("change-close").addEventListener("click", () => {
  seen = get("change").message;
  showChange(get("change"));
});
