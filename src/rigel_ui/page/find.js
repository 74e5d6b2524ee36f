// The text that the reader searches for.

import { byId } from "./dom.js";

const readers = [];
const field = byId("find");

/** Return whether one of these texts contains it. */
export function matches(...texts) {
  const wanted = field.value.trim().toLowerCase();
  return !wanted || texts.some((text) => (text ?? "").toLowerCase().includes(wanted));
}

/** Return whether the reader searches for anything. */
export const finding = () => field.value.trim() !== "";

/** Call a function when the text changes. */
export const onFind = (call) => readers.push(call);

field.addEventListener("input", () => {
  for (const call of readers) call();
});
