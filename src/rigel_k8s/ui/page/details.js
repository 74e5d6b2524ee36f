// The chosen node: its state and cause, its pods, its topics.

import { byId, make, setText, showTime, update } from "./dom.js";
import { shorten } from "./nodes.js";
import { onSelect, selected } from "./selection.js";
import { drawIcon, wordsOf } from "./states.js";
import { get, group, has } from "./store.js";

/** Show what has changed. */
export function showDetails() {
  const workload = selected();
  if (!workload) return;
  const node = get(`node/${workload}`);
  setText(byId("details-title"), node.name ?? workload);
  if (!has(`node/${workload}`)) {
    update(byId("details"), [make("p", { class: "note" }, "This node is not in the release.")], "absent");
    return;
  }
  const names = group("box").filter((box) => box.workload === workload).map((box) => box.name);
  const topics = group("topic").filter((topic) => names.some((name) => topic.from.includes(name) || topic.to.includes(name)));
  const parts = [
    make("p", { class: `state ${node.state}` }, drawIcon(node.state), " ", make("strong", {}, wordsOf(node.state)), ` on ${node.machine || "no machine"}`),
    node.cause ? make("p", { class: "cause" }, node.cause) : null,
    node.remedy ? make("p", { class: "cause" }, node.remedy) : null,
    make("dl", {}, ...pair("Image", shorten(node.image)), ...pair("Pods", `${node.ready} of ${node.desired} ready`), ...pair("Restarts", String(node.restarts))),
    list("Publishes", topics.filter((topic) => names.some((name) => topic.from.includes(name))), names),
    list("Subscribes to", topics.filter((topic) => names.some((name) => topic.to.includes(name))), names),
    make("h3", {}, "Pods"),
    make("ul", { class: "pods" }, ...node.pods.map(showPod)),
  ];
  update(byId("details"), parts.filter(Boolean), [node, topics]);
}

const pair = (name, value) => [make("dt", {}, name), make("dd", {}, value)];

function list(title, topics, names) {
  if (!topics.length) return null;
  const items = topics.map((topic) => {
    const lost = topic.lost.some((name) => names.includes(name)) ? " (lost)" : "";
    const words = [topic.type, topic.rate].filter(Boolean).join(", ");
    return make("li", {}, make("code", {}, topic.name), `${words ? ` ${words}` : ""}${lost}`);
  });
  return make("div", {}, make("h3", {}, title), make("ul", { class: "topics" }, ...items));
}

function showPod(pod) {
  const words = [pod.phase, pod.ready ? "ready" : "not ready", pod.node && `on ${pod.node}`, pod.ip, `since ${showTime(pod.created)}`];
  return make("li", {}, make("code", {}, pod.name), ` ${words.filter(Boolean).join(", ")}`, pod.message ? make("span", { class: "cause" }, ` ${pod.message}`) : null);
}

onSelect(showDetails);
