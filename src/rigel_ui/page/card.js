// Pieces of the cards of nodes and topics.

import { byId, make, setText } from "./dom.js";
import { select, selectTopic } from "./selection.js";
import { group } from "./store.js";

/** Return names with their values, for a list of descriptions; those without a value are left out. */
export const pairs = (...rows) => make("dl", {}, ...rows.filter(([, value]) => value).flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));

/** Return a list with a title, null without items. */
export const list = (title, items) =>
  items.length ? make("div", {}, make("h3", {}, title), make("ul", {}, ...items.map((item) => make("li", {}, ...[item].flat())))) : null;

/** Return a button that leads to the card of a topic. */
export const leadToTopic = (name) => lead(`topic ${name}`, name, () => selectTopic(name));

/** Return a button that leads to the card of a node; only its name if it is not of the release. */
export function leadToNode(name) {
  const workload = group("box").find((box) => box.name === name)?.workload;
  return workload ? lead(`node ${workload}`, name, () => select(workload)) : make("code", {}, name);
}

/** Return a button; the focus goes to the title of the card that it leads to. */
function lead(key, name, go) {
  const onclick = () => {
    go();
    byId("details-title").focus();
  };
  return make("button", { type: "button", class: "link", "data-keep": key, onclick }, make("code", {}, name));
}

/** Return commands with buttons that copy them. A name that a shell would interpret has none. */
export function listCommands(name, ...commands) {
  return list("In a terminal", /^[\w/~][\w/~.-]*$/.test(name) ? commands.map(offer) : []);
}

function offer(command) {
  const code = make("code", {}, command);
  const onclick = (event) => copy(code, event.currentTarget);
  return [code, " ", make("button", { type: "button", "aria-label": `Copy ${command}`, "data-keep": command, onclick }, "Copy")];
}

async function copy(code, button) {
  try {
    await navigator.clipboard.writeText(code.textContent);
    setText(button, "Copied");
    button.setAttribute("aria-label", `Copied ${code.textContent}`);
    setText(byId("announcer"), `Copied ${code.textContent}`);
  } catch {
    getSelection().selectAllChildren(code); // the browser does not allow it: Ctrl-C does
  }
}
