// What the reader looks for.

import { byId } from "./dom.js";

const readers = [];
const field = byId("find");

/** Whether one of some texts has what is looked for. */
export function matches(...texts) {
  const wanted = field.value.trim().toLowerCase();
  return !wanted || texts.some((text) => (text ?? "").toLowerCase().includes(wanted));
}

/** Whether something is looked for. */
export const finding = () => field.value.trim() !== "";

/** Call a function when something else is looked for. */
export const onFind = (call) => readers.push(call);

field.addEventListener("input", () => {
  for (const call of readers) call();
});
