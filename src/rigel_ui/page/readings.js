// What is read once when the reader asks: the next message of a topic, the parameters of a node.
// It has a place below the card: what changes in the card leaves its scrolling and focus alone.

import { byId, make, setText, showTime, update } from "./dom.js";
import { onChoose, selected, selectedTopic } from "./selection.js";
import { group } from "./store.js";

const made = new Map(); // what has been shown, so that a card has it again

/** Show what can be read of what is chosen, with what has been read. */
export function showReadings() {
  const nodes = group("box").filter((box) => selected() && box.workload === selected()).map((box) => box.name);
  const offered = selectedTopic()
    ? [["message", selectedTopic(), "Show a message"]]
    : nodes.map((name) => ["parameters", name, nodes.length > 1 ? `Show parameters of ${name}` : "Show parameters"]);
  update(byId("readings"), offered.map(offer), offered);
}

function offer(one) {
  const key = one.join(" ");
  if (!made.has(key)) made.set(key, makeReading(...one));
  return made.get(key);
}

function makeReading(kind, name, words) {
  const note = make("span", { class: "note" });
  const result = make("div");
  const say = (text) => {
    setText(note, text);
    setText(byId("announcer"), `${kind} of ${name}: ${text}`);
  };
  const onclick = async ({ currentTarget: button }) => {
    if (button.hasAttribute("aria-disabled")) return;
    button.setAttribute("aria-disabled", "true"); // it keeps the focus
    say("reading…");
    const answer = await read(kind, name);
    button.removeAttribute("aria-disabled");
    result.replaceChildren(...(answer.error ? [make("p", { class: "cause wrong" }, answer.error)] : show(answer, `${kind} of ${name}`)));
    say(answer.error ? "failed" : `read at ${showTime(answer.read)}`);
  };
  return make("div", { class: "reading" }, make("button", { type: "button", onclick }, words), " ", note, result);
}

async function read(kind, name) {
  try {
    const answer = await fetch(`${kind}?${new URLSearchParams({ name })}`);
    return answer.ok ? await answer.json() : { error: await answer.text() };
  } catch (error) {
    return { error: `The request failed: ${error.message}` };
  }
}

function show({ text, shortened, rows }, label) {
  const area = (...children) => make("div", { class: "area", tabindex: 0, role: "region", "aria-label": label }, ...children);
  if (!rows) return [area(make("code", {}, text)), shortened ? make("p", { class: "note" }, "Long arrays and texts are shortened.") : ""];
  if (!rows.length) return [make("p", { class: "note" }, "It has no parameters.")];
  const heads = ["Name", "Value"].map((head) => make("th", { scope: "col" }, head));
  const lines = rows.map(([name, value]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, make("code", {}, value))));
  return [area(make("table", {}, make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...lines)))];
}

onChoose(showReadings);
