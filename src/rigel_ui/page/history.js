// The revisions of the release, the newest first; a rollback, if the server allows it.

import { byId, make, setText, showTime, update } from "./dom.js";
import { get, group } from "./store.js";
import { isRolling } from "./summary.js";

let target = null;

/** Show what has changed. */
export function showHistory(groups) {
  if (!["revision", "release", "server", "change"].some((name) => groups.has(name))) return;
  const revisions = group("revision").sort((a, b) => b.number - a.number);
  const now = get("release").revision;
  const allowed = get("server").changes;
  const busy = get("change").state === "running";
  const rolling = isRolling(get("release"));
  const items = revisions.map((one) => makeItem(one, { now: one.number === now, allowed, busy, rolling }));
  const focused = document.activeElement?.dataset?.revision;
  if (update(byId("history"), items, [revisions, now, allowed, busy, rolling]) && focused) {
    byId("history").querySelector(`[data-revision="${CSS.escape(focused)}"]`)?.focus();
  }
  const hidden = get("release").status === "unseen";
  setText(byId("history-note"), hidden ? "The right to watch Secrets is missing." : revisions.length && !allowed ? "Read-only: start rigel ui with --allow-changes to roll back here." : "");
}

function makeItem(one, { now, allowed, busy, rolling }) {
  const status = one.status === "pending" && !(now && rolling) ? "interrupted" : one.status; // its deploy was killed
  const item = make(
    "li",
    { class: status },
    make("p", {}, make("strong", {}, `Revision ${one.number}`), ` ${status}, `, make("time", { datetime: one.created }, showTime(one.created)), one.by ? ` by ${one.by}` : "", now ? " (present)" : ""),
    one.description ? make("p", {}, one.description) : null,
    one.changes.length ? make("ul", {}, ...one.changes.map((text) => make("li", {}, text))) : null,
  );
  if (allowed && !now) {
    const doubt = { failed: ", which has failed", interrupted: ", which was interrupted" }[status] ?? "";
    item.append(make("button", { type: "button", class: doubt && "doubtful", "data-revision": one.number, disabled: busy, onclick: () => ask(one, doubt) }, `Roll back to revision ${one.number}${doubt}…`));
  }
  return item;
}

function ask(one, doubt) {
  target = one;
  const place = get("cluster");
  setText(byId("confirm-title"), `Roll back to revision ${one.number}${doubt}?`);
  setText(byId("confirm-text"), one.back.length
    ? `The release ${place.release} in the namespace ${place.namespace} changes as follows. Nodes that change restart.`
    : `The workloads of the release ${place.release} in the namespace ${place.namespace} stay as they are.`);
  byId("confirm-changes").replaceChildren(...one.back.map((text) => make("li", {}, text)));
  setText(byId("confirm-error"), "");
  byId("confirm").showModal();
  byId("confirm-no").focus();
}

async function confirm() {
  try {
    const answer = await fetch("rollback", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ revision: target.number }),
    });
    if (answer.ok) {
      byId("confirm").close();
      return;
    }
    setText(byId("confirm-error"), (await answer.json()).message);
  } catch (error) {
    setText(byId("confirm-error"), `The request failed: ${error.message}`);
  }
}

byId("confirm-no").addEventListener("click", () => byId("confirm").close());
byId("confirm-yes").addEventListener("click", confirm);
