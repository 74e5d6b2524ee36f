// Makes elements. Texts from the cluster are always shown as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

/** Return the element of the page with this id. */
export const byId = (id) => document.getElementById(id);

/** Return an HTML element with attributes, and texts or elements in it. */
export function make(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

/** Return an SVG element. */
export function draw(name, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, name), attributes, children);
}

function fill(element, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "onclick") element.addEventListener("click", value);
    else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(key, value === true ? "" : String(value));
    }
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Give an element these children, unless it has them already: so focus and scrolling stay. */
export function update(element, children, key = "") {
  const text = JSON.stringify(key);
  if (key !== "" && element.dataset.shown === text) return false;
  element.dataset.shown = text;
  element.replaceChildren(...children);
  return true;
}

/** Give an element a text, unless it has it already. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Return a time from Kubernetes in the reader's time zone, with the date if it is not today. */
export function showTime(text) {
  const time = new Date(text);
  if (Number.isNaN(time.getTime())) return text;
  const clock = time.toLocaleTimeString([], { hourCycle: "h23" });
  const today = time.toDateString() === new Date().toDateString();
  return today ? clock : `${time.toLocaleDateString()} ${clock}`;
}
