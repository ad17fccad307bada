// Names of probes: a search over them, presets, what those of a plot have in common, and why some were rejected.

import { make } from "./dom.js";

/** @typedef {{ name: string, unit: string, thread: string, period_s: number, source: string }} Probe */

/** Names that a search lists. */
const LISTED_MAX = 200;

/** The probes whose names have all words of a text, in any order; those that begin with it first.
 * @param {Probe[]} probes @param {string} text @returns {Probe[]} */
export function search(probes, text) {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  const found = probes.filter(({ name }) => words.every(word => name.toLowerCase().includes(word)));
  const begins = (/** @type {Probe} */ probe) => words.length > 0 && probe.name.toLowerCase().startsWith(words[0]);
  return [...found.filter(begins), ...found.filter(probe => !begins(probe))];
}

/** A plot for each first part of the names that match. @param {Probe[]} probes @param {RegExp} pattern
 * @returns {string[][]} */
function grouped(probes, pattern) {
  /** @type {Map<string, string[]>} */
  const plots = new Map();
  for (const { name } of probes) {
    const match = pattern.exec(name);
    if (match) plots.set(match[1], [...(plots.get(match[1]) ?? []), name]);
  }
  return [...plots.values()];
}

/** @type {{ id: string, title: string, plots: (probes: Probe[]) => string[][] }[]} */
export const PRESETS = [
  { id: "following", title: "following error", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.following_error$/) },
  { id: "positions", title: "joint positions", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.measured$/) },
  { id: "velocities", title: "joint velocities", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.velocity$/) },
  { id: "force", title: "force and torque", plots: probes => [...grouped(probes, /^(.+)\.force\.[xyz]$/), ...grouped(probes, /^(.+)\.force\.r[xyz]$/)] },
  { id: "latency", title: "latency of threads", plots: probes => [...grouped(probes, /^thread:(.+)\.latency$/), ...grouped(probes, /^thread:(.+)\.execution$/),
    ...grouped(probes, /^thread:(.+)\.phase_error$/)] },
];

/** Why probes were rejected: each cause once. @param {import("./scope.js").Rejected[]} rejected */
export function causes(rejected) {
  const texts = [...new Set(rejected.map(({ cause, hint }) => cause + (hint ? "\nhint: " + hint : "")))];
  return texts.map(text => {
    const names = rejected.filter(({ cause, hint }) => cause + (hint ? "\nhint: " + hint : "") === text).map(({ probe }) => probe);
    return (names.length > 3 ? names.length + " probes" : names.join(", ")) + ": " + text;
  }).join("\n");
}

/** What the names of a plot have in common, with an asterisk where they differ, and what of each is left.
 * @param {string[]} names @returns {{ common: string, rest: string[] }} */
export function shorten(names) {
  if (names.length < 2) return { common: "", rest: names };
  const parts = names.map(name => name.split(/(?<=[./:])/)), most = Math.min(...parts.map(it => it.length)) - 1;
  const same = (/** @type {(parts: string[]) => string} */ pick) => parts.every(it => pick(it) === pick(parts[0]));
  let before = 0, after = 0;
  while (before < most && same(it => it[before])) before++;
  while (after < most - before && same(it => it[it.length - 1 - after])) after++;
  if (before + after === 0) return { common: "", rest: names };
  const rest = parts.map(it => it.slice(before, it.length - after).join("").replace(/\.$/, ""));
  const end = after ? "." + parts[0].slice(parts[0].length - after).join("") : "";
  return { common: parts[0].slice(0, before).join("") + "*" + end, rest };
}

/** The element with search and presets. @param {(names: string[]) => void} add plots these together @param {(preset: string) => void} choose */
export function picker(add, choose) {
  const element = make("div", undefined, "picker"), bar = make("div", undefined, "row"), found = make("div", undefined, "found");
  const input = /** @type {HTMLInputElement} */ (make("input")), presets = /** @type {HTMLSelectElement} */ (make("select"));
  input.type = "search";
  input.placeholder = "Search probes: left following_error";
  input.setAttribute("aria-label", "Search probes");
  presets.append(new Option("Presets …", ""), ...PRESETS.map(preset => new Option(preset.title, preset.id)));
  presets.setAttribute("aria-label", "Presets");
  presets.onchange = () => { if (presets.value) choose(presets.value); presets.value = ""; };
  const together = /** @type {HTMLButtonElement} */ (make("button", "Plot together")), each = /** @type {HTMLButtonElement} */ (make("button", "Plot each"));
  /** @type {Probe[]} */
  let probes = [];
  /** @type {Set<string>} */
  const chosen = new Set();
  const show = () => {
    const isOpen = input.value.trim() !== "" || chosen.size > 0;
    const matches = isOpen ? search(probes, input.value) : [];
    found.hidden = !isOpen;
    together.disabled = each.disabled = !chosen.size;
    together.textContent = chosen.size > 1 ? `Plot ${chosen.size} together` : "Plot";
    each.hidden = chosen.size < 2;
    const rows = matches.slice(0, LISTED_MAX).map(probe => {
      const label = make("label"), box = /** @type {HTMLInputElement} */ (make("input"));
      box.type = "checkbox";
      box.checked = chosen.has(probe.name);
      box.onchange = () => { if (box.checked) chosen.add(probe.name); else chosen.delete(probe.name); buttons(); };
      label.append(box, " " + probe.name, make("span", probe.unit, "dim"));
      return label;
    });
    const more = matches.length > LISTED_MAX ? [make("p", `${matches.length - LISTED_MAX} more: add a word`, "dim")] : [];
    found.replaceChildren(...(matches.length ? [...rows, ...more] : [make("p", probes.length ? "no probe has these words" : "no probes yet", "dim")]));
  };
  const buttons = () => {
    together.disabled = each.disabled = !chosen.size;
    together.textContent = chosen.size > 1 ? `Plot ${chosen.size} together` : "Plot";
    each.hidden = chosen.size < 2;
  };
  const done = () => { chosen.clear(); input.value = ""; show(); };
  together.onclick = () => { add([...chosen]); done(); };
  each.onclick = () => { [...chosen].forEach(name => add([name])); done(); };
  input.oninput = show;
  input.onkeydown = event => {
    if (event.key === "Escape") done();
    if (event.key !== "Enter") return;
    const [first] = search(probes, input.value);
    if (!chosen.size && first) chosen.add(first.name);
    if (chosen.size) together.onclick?.(/** @type {any} */ (event));
  };
  bar.append(input, together, each, presets);
  element.append(bar, found);
  show();
  return {
    element,
    /** @param {Probe[]} known */
    offer: known => {
      const isNew = known.length !== probes.length;
      probes = known;
      if (isNew && input.value) show();
    },
  };
}
