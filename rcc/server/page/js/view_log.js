// The log, by level and text.

import { list, make, section } from "./dom.js";

/** @typedef {import("./api.js").App} App */

/** Levels, the worst first, as the log writes them. */
const LEVELS = ["ERROR", "WARN", "INFO", "DEBUG", "TRACE"];
/** Lines that are kept. */
const LINES_MAX = 4000;

/** The level of a line; what has none goes with the line before it. @param {string} line @param {number} before */
export function levelOf(line, before) {
  const found = LEVELS.findIndex(level => new RegExp("(^|\\s)" + level + "(\\s|:)").test(line.slice(0, 60)));
  return found < 0 ? before : found;
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const box = section("Log"), bar = make("div", undefined, "row"), lines = make("pre", undefined, "log");
  const level = /** @type {HTMLSelectElement} */ (make("select")), filter = /** @type {HTMLInputElement} */ (make("input"));
  const count = make("span", "", "dim");
  lines.id = "log";
  lines.tabIndex = 0;
  level.append(...LEVELS.map(name => make("option", name === "TRACE" ? "all levels" : name === "ERROR" ? "ERROR" : name + " and worse")));
  level.selectedIndex = LEVELS.length - 1;
  level.setAttribute("aria-label", "Level");
  filter.type = "search";
  filter.placeholder = "contains…";
  filter.setAttribute("aria-label", "Lines that contain");
  bar.append(level, filter, count);
  box.append(bar, lines);
  element.append(box);
  let next = 0;
  /** @type {{ text: string, level: number }[]} */
  let kept = [];
  const show = () => {
    const wanted = filter.value.toLowerCase(), isAtEnd = lines.scrollTop + lines.clientHeight >= lines.scrollHeight - 8;
    const shown = kept.filter(line => line.level <= level.selectedIndex && line.text.toLowerCase().includes(wanted));
    lines.replaceChildren(...shown.map(line => make("span", line.text + "\n", ["bad", "warn", "", "dim", "dim"][line.level])));
    count.textContent = shown.length + " of " + kept.length + " lines";
    if (isAtEnd) lines.scrollTop = lines.scrollHeight;
  };
  level.onchange = filter.oninput = show;
  app.every(500, async () => {
    const log = await app.get("/log/?start=" + next), fresh = list(log, "line");
    next = Number(log.next);
    for (const { text } of fresh) kept.push({ text: text ?? "", level: levelOf(text ?? "", kept.at(-1)?.level ?? 2) });
    kept = kept.slice(-LINES_MAX);
    if (fresh.length || !count.textContent) show();
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "log", title: "Log", mount, unmount() {} };
