// What the server has sent: entries by key, and the functions to call when they change.

const entries = new Map();
const readers = [];
let pending = null;

/** Return an entry, or an empty one. */
export const get = (key) => entries.get(key) ?? {};

/** Return whether there is such an entry. */
export const has = (key) => entries.has(key);

/** Return the entries of a group by the rest of their key. */
export function group(name) {
  const prefix = `${name}/`;
  return [...entries].filter(([key]) => key.startsWith(prefix)).map(([, value]) => value);
}

/** Call a function with the keys that have changed, at most once a frame. */
export const onChange = (call) => readers.push(call);

/** Take in a message of the server. */
export function take(message) {
  const changed = new Set();
  if (message.all) {
    for (const key of entries.keys()) changed.add(key);
    entries.clear();
  }
  for (const key of message.gone ?? []) {
    entries.delete(key);
    changed.add(key);
  }
  for (const [key, value] of Object.entries(message.all ?? message.set ?? {})) {
    entries.set(key, value);
    changed.add(key);
  }
  notify(changed);
}

function notify(changed) {
  if (pending) {
    for (const key of changed) pending.add(key);
    return;
  }
  pending = changed;
  // A page in the background is drawn as well: its title shows what has crashed.
  setTimeout(() => {
    const keys = pending;
    pending = null;
    const groups = new Set([...keys].map((key) => key.split("/", 1)[0]));
    for (const call of readers) call(groups, keys);
  }, 16);
}
