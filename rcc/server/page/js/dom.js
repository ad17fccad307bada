// What all views draw with: elements, tables, figures, histograms. It requests nothing.

/**
 * A cell of a table: a text, an element, a number, one value, or values between which lines may break.
 * @typedef {string | Node | { number: string | number } | { value: string } | { values: string[] }} Cell
 * @typedef {{ cells: Cell[], pick?: () => void, isPicked?: boolean }} Row
 * @typedef {Record<string, any>} Json An object of a resource; numbers of older resources are texts.
 */

/** The element of that id, which index.html has.
 * @param {string} id @returns {HTMLElement} */
export function byId(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error("the page has no element " + id);
  return element;
}

/** @param {string} tag @param {string | number} [text] @param {string} [kind] its class */
export function make(tag, text, kind) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = String(text);
  if (kind) element.className = kind;
  return element;
}

/** The children of that name; none if there are none.
 * @param {Json | undefined} object @param {string} name @returns {Json[]} */
export const list = (object, name) => (object && object[name]) || [];

/** A section with its heading. @param {string} title @param {string} [kind] @param {...(Node | string)} children */
export function section(title, kind = "", ...children) {
  const box = make("section", undefined, kind);
  box.append(make("h2", title), ...children);
  return box;
}

const GOOD = ["RUNNING", "op", "READY", "ACTIVE", "FIRED", "running", "ready", "active", "info", "ok", "good"];
const WARN = ["CANCELLING", "SCHEDULED", "LOADING", "safeop", "loading", "stopping", "warning", "warn", "stale"];
const QUIET = ["TERMINATED", "INACTIVE", "inactive", "ended", "stopped"];

/** A state as a pill. @param {string} word */
export function state(word) {
  const kind = GOOD.includes(word) ? "good" : WARN.includes(word) ? "warn" : QUIET.includes(word) ? "dim" : "bad";
  return make("span", word, "state " + kind);
}

/** @param {string[]} heads @param {Row[]} rows @param {string} empty text if there are no rows */
export function table(heads, rows, empty) {
  if (!rows.length) return make("p", empty, "dim");
  const table = /** @type {HTMLTableElement} */ (make("table"));
  const head = table.createTHead().insertRow(), body = table.createTBody();
  for (const name of heads) head.append(make("th", name, /count|ms|rad|%|°|kbit/.test(name) ? "number" : ""));
  for (const { cells, pick, isPicked } of rows) {
    const row = body.insertRow();
    if (pick) {
      row.className = "pick" + (isPicked ? " picked" : "");
      row.tabIndex = 0;
      row.setAttribute("aria-selected", String(!!isPicked));
      row.onclick = pick;
      row.onkeydown = event => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); pick(); } };
    }
    for (const cell of cells) fillCell(row.insertCell(), cell);
  }
  return table;
}

/** @param {HTMLTableCellElement} td @param {Cell} cell */
function fillCell(td, cell) {
  if (cell instanceof Node) td.append(cell);
  else if (typeof cell !== "object" || cell === null) td.textContent = cell ?? "";
  else if ("number" in cell) { td.textContent = String(cell.number); td.className = "number"; }
  else if ("value" in cell) { td.append(...breakable(cell.value)); td.className = "value"; }
  else { td.append(...cell.values.map(text => make("span", text))); td.className = "value"; }
}

/** The text, whose lines may break behind separators and nowhere else.
 * @param {string} text @returns {(string | Node)[]} */
export function breakable(text) {
  return text.split(/(?<=[,;\]}])/).flatMap(part => [part, make("wbr")]);
}

/** A named number. @param {string} name @param {string | number} text @param {string} [kind] */
export function figure(name, text, kind) {
  const box = make("div");
  box.append(make("span", name), make("b", text, kind));
  return box;
}

/** @param {...Node} children */
export function figures(...children) {
  const box = make("div", undefined, "figures");
  box.append(...children);
  return box;
}

/** A time of so many milliseconds, in a readable unit. @param {string | number | undefined} ms */
export function span(ms) {
  const value = Number(ms);
  if (!isFinite(value)) return "—";
  if (value >= 1000) return (value / 1000).toPrecision(3) + " s";
  return value >= 1 ? value.toPrecision(3) + " ms" : (value * 1000).toPrecision(3) + " µs";
}

/** A histogram whose buckets are cumulative, with logarithmic heights. @param {Json} figure */
export function bars(figure) {
  const box = make("div", undefined, "bars");
  let before = 0;
  /** @type {[string, number][]} */
  const counts = list(figure, "bucket").map(bucket => {
    const count = Number(bucket.count) - before;
    before = Number(bucket.count);
    return [span(bucket.le), count];
  });
  counts.push(["more", Number(figure.count) - before]);
  const most = Math.max(1, ...counts.map(([, count]) => Math.log10(1 + count)));
  for (const [name, count] of counts) {
    const column = make("div"), bar = make("i");
    bar.style.height = 80 * Math.log10(1 + Math.max(0, count)) / most + "%";
    column.title = count + " cycles up to " + name;
    column.append(bar, make("small", name.replace(/\.0+(?= )/, "").replace(/ (.)s$/, "$1").replace(" s", "s")));
    box.append(column);
  }
  return box;
}

/** An event of a device or net: cause, then remedy. @param {string} name @param {Json} event */
export function note(name, event) {
  const box = make("p", undefined, "note " + (event.severity === "error" ? "bad" : event.severity === "info" ? "dim" : "warn"));
  box.append(name + ": " + event.cause + " (" + ago(Number(event.ago) / 1000) + " ago)");
  if (Number(event.times) > 1) box.append(" ×" + event.times);
  if (event.hint) box.append(make("br"), make("span", "hint: " + event.hint));
  return box;
}

/** A time of so many seconds, roughly. @param {number} seconds */
export function ago(seconds) {
  if (seconds < 120) return seconds.toFixed(0) + " s";
  if (seconds < 7200) return (seconds / 60).toFixed(0) + " min";
  return seconds < 172800 ? (seconds / 3600).toFixed(0) + " h" : (seconds / 86400).toFixed(0) + " d";
}

/** A button that calls `press`, disabled meanwhile. @param {string} text @param {() => unknown} press @param {string} [kind] */
export function button(text, press, kind) {
  const element = /** @type {HTMLButtonElement} */ (make("button", text, kind));
  element.type = "button";
  element.onclick = async () => {
    element.disabled = true;
    try { await press(); } finally { element.disabled = false; }
  };
  return element;
}

/** What can have the keyboard in a box. @param {Element} box */
const focusable = box => /** @type {HTMLElement[]} */ ([...box.querySelectorAll("a, button, input, select, summary, [tabindex]")]);

/** Replaces the children of a box, unless the new ones look the same: what a pointer is about to press stays, and the keyboard stays
 * where it is. @param {Element} box @param {...(Node | string)} children */
export function swap(box, ...children) {
  const next = /** @type {Element} */ (box.cloneNode(false));
  next.append(...children);
  if (next.isEqualNode(box)) return;
  const at = box.contains(document.activeElement) ? focusable(box).indexOf(/** @type {HTMLElement} */ (document.activeElement)) : -1;
  box.replaceChildren(...next.childNodes);
  if (at >= 0) focusable(box)[at]?.focus({ preventScroll: true });
}
