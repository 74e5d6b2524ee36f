// The card of a topic: its type, its nodes, and its rate over the last minutes.

import { leadToNode, list, listCommands, pairs } from "./card.js";
import { make } from "./dom.js";
import { drawRate } from "./plot.js";
import { get, group, has } from "./store.js";

/** Return the title of a topic's card, what is in it, and what that is made of. */
export function describeTopic(name) {
  const topic = get(`topic/${name}`);
  const known = has(`topic/${name}`);
  const nodes = (names) => (names ?? []).map((one) => [leadToNode(one), topic.lost.includes(one) ? " (lost)" : ""]);
  const parts = [
    known ? pairs(["Type", topic.type || "unknown"], ["Rate", topic.rate || "unknown"]) : make("p", { class: "note" }, "This topic is not in the ROS graph."),
    drawRate(name),
    list("Publishers", nodes(topic.from)),
    list("Subscribers", nodes(topic.to)),
    listCommands(name, `rigel topic echo ${name}`),
  ];
  return [name, parts, [known, topic, group("rates"), group("box").map((box) => [box.name, box.workload])]];
}
