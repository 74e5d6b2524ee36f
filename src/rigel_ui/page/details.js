// The card of what is chosen: a topic, or a node with its state and cause, its pods, its topics.

import { leadToTopic, list, listCommands, pairs } from "./card.js";
import { byId, make, setText, showTime, update } from "./dom.js";
import { shorten } from "./nodes.js";
import { onChoose, selected, selectedTopic } from "./selection.js";
import { drawIcon, wordsOf } from "./states.js";
import { get, group, has } from "./store.js";
import { describeTopic } from "./topic.js";

/** Show what has changed. */
export function showDetails() {
  if (!selected() && !selectedTopic()) return;
  const [title, parts, key] = selectedTopic() ? describeTopic(selectedTopic()) : describeNode(selected());
  const area = byId("details");
  const focused = area.contains(document.activeElement) && document.activeElement.dataset.keep;
  setText(byId("details-title"), title);
  if (update(area, parts.filter(Boolean), [title, key]) && focused) {
    area.querySelector(`[data-keep="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
  }
}

function describeNode(workload) {
  const node = get(`node/${workload}`);
  if (!has(`node/${workload}`)) return [workload, [make("p", { class: "note" }, "This node is not in the release.")], "absent"];
  const boxes = group("box").filter((box) => box.workload === workload);
  const names = boxes.map((box) => box.name);
  const topics = group("topic").filter((topic) => names.some((name) => topic.from.includes(name) || topic.to.includes(name)));
  const services = boxes.flatMap((box) => box.services);
  const parts = [
    make("p", { class: `state ${node.state}` }, drawIcon(node.state), " ", make("strong", {}, wordsOf(node.state)), ` on ${node.machine || "no machine"}`),
    node.cause ? make("p", { class: "cause" }, node.cause) : null,
    node.remedy ? make("p", { class: "cause" }, node.remedy) : null,
    pairs(["Image", shorten(node.image)], ["Pods", `${node.ready} of ${node.desired} ready`], ["Restarts", String(node.restarts)]),
    list("Publishes", listTopics(topics, "from", names)),
    list("Subscribes to", listTopics(topics, "to", names)),
    list("Services", services.map(({ name, type }) => [make("code", {}, name), type ? ` ${type}` : ""])),
    list("Pods", node.pods.map(showPod)),
    listCommands(workload, `rigel exec -it ${workload} -- bash`, `rigel logs -f ${workload}`),
  ];
  return [node.name, parts, [node, topics, services]];
}

function listTopics(topics, end, names) {
  return topics.filter((topic) => names.some((name) => topic[end].includes(name))).map((topic) => {
    const words = [topic.type, topic.rate].filter(Boolean).join(", ");
    const lost = topic.lost.some((name) => names.includes(name)) ? " (lost)" : "";
    return [leadToTopic(topic.name), `${words ? ` ${words}` : ""}${lost}`];
  });
}

function showPod(pod) {
  const words = [pod.phase, pod.ready ? "ready" : "not ready", pod.node && `on ${pod.node}`, pod.ip, `since ${showTime(pod.created)}`];
  return [make("code", {}, pod.name), ` ${words.filter(Boolean).join(", ")}`, pod.message ? make("span", { class: "cause" }, ` ${pod.message}`) : ""];
}

const narrow = matchMedia("(max-width: 900px)"); // style.css has the same width

onChoose(() => {
  showDetails();
  if (narrow.matches) byId("details-part").scrollIntoView({ block: "nearest" });
});
