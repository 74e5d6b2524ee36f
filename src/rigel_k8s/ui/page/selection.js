// Which node the reader has chosen: by its workload, in the address, so that a reload keeps it.

const readers = [];
let current = new URLSearchParams(location.hash.slice(1)).get("node") ?? "";

/** Return the workload of the chosen node, "" for none. */
export const selected = () => current;

/** Call a function when another node is chosen. */
export const onSelect = (call) => readers.push(call);

/** Choose a node. */
export function select(workload) {
  if (workload === current) return;
  current = workload;
  history.replaceState(null, "", workload ? `#node=${encodeURIComponent(workload)}` : "#");
  for (const call of readers) call();
}
