// The rate of a topic over the last minutes. A reading without it is a gap, and so is a time
// without readings.

import { draw, make, showTime } from "./dom.js";
import { group } from "./store.js";

const SPAN = 600; // seconds
const APART = 60; // seconds between two readings from which on they are not connected: no page was open
const FRAME = { left: 46, right: 394, top: 12, bottom: 92, width: 400, height: 112 };

/** Return a rate in words, as the graph has it. */
export function writeRate(value) {
  if (value >= 100) return `${value.toFixed(0)}/s`;
  return `${value >= 1 ? value.toFixed(1) : Number(value.toPrecision(2))}/s`;
}

/** Return the plot of a topic. */
export function drawRate(topic) {
  const readings = group("rates").sort((a, b) => a.begun - b.begun);
  const end = readings.at(-1)?.begun ?? 0;
  const runs = connect(readings.filter(({ begun }) => begun >= end - SPAN), topic);
  const values = runs.flat().map(({ rate }) => rate);
  if (!values.length) return make("p", { class: "note" }, "No rate has been measured in the last minutes.");
  const top = roundUp(Math.max(...values) * 1.05);
  const x = (time) => FRAME.right - ((end - time) / SPAN) * (FRAME.right - FRAME.left);
  const y = (rate) => FRAME.bottom - (rate / top) * (FRAME.bottom - FRAME.top);
  const clock = (time) => showTime(time * 1000);
  const gaps = runs.length > 1 ? `, with ${runs.length - 1} ${runs.length > 2 ? "gaps" : "gap"}` : "";
  const words = `Rate from ${clock(end - SPAN)} to ${clock(end)}: ${writeRate(Math.min(...values))} to ${writeRate(Math.max(...values))}${gaps}`;
  const level = (rate) => [
    draw("line", { x1: FRAME.left, x2: FRAME.right, y1: y(rate), y2: y(rate) }),
    draw("text", { x: FRAME.left - 6, y: y(rate) + 4, "text-anchor": "end" }, rate ? writeRate(rate) : "0"),
  ];
  return draw("svg", { class: "plot", viewBox: `0 0 ${FRAME.width} ${FRAME.height}`, role: "img", "aria-label": words },
    ...level(top), ...level(0),
    draw("text", { x: FRAME.left, y: FRAME.height - 4 }, clock(end - SPAN)),
    draw("text", { x: FRAME.right, y: FRAME.height - 4, "text-anchor": "end" }, clock(end)),
    ...runs.map((run) => draw("polyline", { points: run.map(({ time, rate }) => `${x(time)},${y(rate)}`).join(" ") })),
    ...runs.flat().map(({ time, rate }) => draw("circle", { cx: x(time), cy: y(rate), r: 2 }, draw("title", {}, `${clock(time)} ${writeRate(rate)}`))));
}

/** Return runs of readings of a topic between its gaps. */
function connect(readings, topic) {
  const runs = [];
  let last = null;
  for (const { begun, ended, of } of readings) {
    const rate = Object.hasOwn(of, topic) ? of[topic] : null;
    if (rate !== null) {
      if (last === null || begun - last > APART) runs.push([]);
      runs.at(-1).push({ time: begun, rate });
    }
    last = rate === null ? null : ended;
  }
  return runs;
}

/** Return a round number that is not below a value. */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value || 1));
  return [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].find((step) => step * power >= value) * power;
}
