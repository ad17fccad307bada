// Choosing probes: a search over their names, and presets.

import { make } from "./dom.js";

/** @typedef {{ name: string, unit: string, thread: string, period_s: number, source: string }} Probe */
/** @typedef {{ title: string, names: string[] }} Plots */

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

/** A plot for each first part of the names that match. @param {Probe[]} probes @param {RegExp} pattern @param {string} title
 * @returns {Plots[]} */
function grouped(probes, pattern, title) {
  /** @type {Map<string, string[]>} */
  const plots = new Map();
  for (const { name } of probes) {
    const match = pattern.exec(name);
    if (match) plots.set(match[1], [...(plots.get(match[1]) ?? []), name]);
  }
  return [...plots].map(([source, names]) => ({ title: `${source}: ${title}`, names }));
}

/** @type {{ id: string, title: string, plots: (probes: Probe[]) => Plots[] }[]} */
export const PRESETS = [
  { id: "following", title: "following error", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.following_error$/, "following error") },
  { id: "positions", title: "joint positions", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.measured$/, "positions") },
  { id: "velocities", title: "joint velocities", plots: probes => grouped(probes, /^(.+)\.joint\.\d+\.velocity$/, "velocities") },
  { id: "force", title: "force and torque", plots: probes => [...grouped(probes, /^(.+)\.force\.[xyz]$/, "force"), ...grouped(probes, /^(.+)\.force\.r[xyz]$/, "torque")] },
  { id: "latency", title: "latency of threads", plots: probes => [...grouped(probes, /^thread:(.+)\.latency$/, "latency"), ...grouped(probes, /^thread:(.+)\.execution$/, "execution"),
    ...grouped(probes, /^thread:(.+)\.phase_error$/, "phase error")] },
];

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
