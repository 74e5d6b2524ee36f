// What the reader has chosen: a node, by its workload, whose log is followed, and perhaps a topic,
// which has the card then. It is in the address, so that a reload keeps it.

const readers = { node: [], any: [] };
const words = new URLSearchParams(location.hash.slice(1));
let chosen = { node: words.get("node") ?? "", topic: words.get("topic") ?? "" };

/** Return the workload of the chosen node, "" for none. */
export const selected = () => chosen.node;

/** Return the name of the chosen topic, "" for none. */
export const selectedTopic = () => chosen.topic;

/** Call a function when another node is chosen. */
export const onSelect = (call) => readers.node.push(call);

/** Call a function when another node or topic is chosen, or the node instead of its topic. */
export const onChoose = (call) => readers.any.push(call);

/** Choose a node. */
export const select = (workload) => choose({ node: workload, topic: "" });

/** Choose a topic; the log stays. */
export const selectTopic = (topic) => choose({ ...chosen, topic });

function choose(next) {
  const before = chosen;
  chosen = next;
  const kept = Object.entries(chosen).filter(([, value]) => value);
  history.replaceState(null, "", `#${new URLSearchParams(kept)}`);
  if (next.node !== before.node) for (const call of readers.node) call();
  if (next.node !== before.node || next.topic !== before.topic) for (const call of readers.any) call();
}
