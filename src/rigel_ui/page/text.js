// Texts in the graph, which have the room that Graphviz gave them.

const measure = document.createElement("canvas").getContext("2d");

/** Return how wide a text is. */
function widthOf(text, font) {
  measure.font = font;
  return measure.measureText(text).width;
}

/** Give an element a whole text, narrower if this browser's font is wider than its room. */
export function squeeze(element, text, font, room) {
  if (element.textContent === text) return;
  element.textContent = text;
  if (widthOf(text, font) > room) {
    element.setAttribute("textLength", room);
    element.setAttribute("lengthAdjust", "spacingAndGlyphs");
  } else element.removeAttribute("textLength");
}

/** Return the first words of a text, as many as fit; a parenthesis is whole or left out. */
export function begin(text, font, room) {
  if (widthOf(text, font) <= room) return text;
  const words = text.split(" ");
  while (words.length > 1) {
    words.pop();
    const left = words.join(" ").replace(/ ?\([^)]*$/, "");
    if (widthOf(`${left} …`, font) <= room) return `${left} …`;
  }
  let kept = text;
  while (kept && widthOf(`${kept}…`, font) > room) kept = kept.slice(0, -1);
  return `${kept}…`;
}
