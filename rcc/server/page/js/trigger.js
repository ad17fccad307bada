// Trigger settings of the scope: a form, and what is asked of the controller for it.

import { make } from "./dom.js";

/** @typedef {import("./scope.js").Trigger} Trigger */
/** @typedef {{ on: string, probe: string, level: string, low: string, high: string, equals: string, source: string, pre: string, post: string, mode: string }} Fields */
/** @typedef {{ trigger: Trigger | null, pre_s: number, post_s: number, mode: "auto" | "normal" | "single" }} Settings */

/** What starts a capture: word of the protocol, text, and the fields that it needs. @type {[string, string, (keyof Fields)[]][]} */
export const KINDS = [
  ["none", "no trigger: roll", []],
  ["rising", "rises above a level", ["probe", "level"]],
  ["falling", "falls below a level", ["probe", "level"]],
  ["above", "is above a level", ["probe", "level"]],
  ["below", "is below a level", ["probe", "level"]],
  ["inside", "is inside a window", ["probe", "low", "high"]],
  ["outside", "is outside a window", ["probe", "low", "high"]],
  ["state", "is in a state", ["probe", "equals"]],
  ["fault", "fault of a device", ["source"]],
  ["event", "event of a device, machine or net", ["source"]],
  ["overrun", "overrun of the first net thread", []],
];
/** @type {[string, string][]} */
const MODES = [["normal", "normal: each time"], ["single", "single: once"], ["auto", "auto: also without trigger"]];

/** Longest time before and after a trigger, s. */
const TIME_MAX = 60;

/** @type {Fields} */
export const DEFAULTS = { on: "none", probe: "", level: "0", low: "-1", high: "1", equals: "", source: "", pre: "0.5", post: "1.5", mode: "normal" };

/** @param {string} name @param {string} text */
function number(name, text) {
  const value = Number(text);
  if (text.trim() === "" || !Number.isFinite(value)) throw new Error(`${name} is "${text}"; a number is expected`);
  return value;
}

/** @param {string} name @param {string} text @param {number} low */
function time(name, text, low) {
  const value = number(name, text);
  if (value < low || value > TIME_MAX) throw new Error(`${name} is ${text} s; ${low} to ${TIME_MAX} s are possible`);
  return value;
}

/** The request for what a form has; throws with the cause if that is not possible. @param {Fields} fields @returns {Settings} */
export function settingsOf(fields) {
  const kind = KINDS.find(([on]) => on === fields.on);
  if (!kind) throw new Error(`trigger "${fields.on}" is unknown`);
  const [on, , needed] = kind;
  const settings = { pre_s: time("time before", fields.pre, 0), post_s: time("time after", fields.post, 0.01), mode: modeOf(fields.mode) };
  if (on === "none") return { trigger: null, ...settings };
  /** @type {Trigger} */
  const trigger = { on };
  if (needed.includes("probe")) {
    if (!fields.probe) throw new Error("the trigger has no probe\nhint: choose one of those that are plotted");
    trigger.probe = fields.probe;
  }
  if (needed.includes("level")) trigger.level = number("level", fields.level);
  if (needed.includes("low")) {
    [trigger.low, trigger.high] = [number("lower end", fields.low), number("upper end", fields.high)];
    if (!(trigger.low < trigger.high)) throw new Error(`the window from ${fields.low} to ${fields.high} is empty`);
  }
  if (needed.includes("equals")) {
    if (!fields.equals.trim()) throw new Error("the state is empty");
    trigger.equals = fields.equals.trim();
  }
  if (needed.includes("source")) {
    if (!fields.source.trim()) throw new Error("the trigger has no source\nhint: write the name of a device, of a machine as machine:cell, of a net as net:swing");
    trigger.probe = fields.source.trim();
  }
  return { trigger, ...settings };
}

/** @param {string} mode @returns {"auto" | "normal" | "single"} */
const modeOf = mode => mode === "auto" || mode === "single" ? mode : "normal";

/** A form for the settings. @param {Fields} fields kept up to date @param {(settings: Settings) => void} apply called when they are complete
 * @param {(text: string) => void} fail called with the cause otherwise */
export function triggerForm(fields, apply, fail) {
  const form = /** @type {HTMLFormElement} */ (make("form", undefined, "row trigger"));
  /** @type {Map<keyof Fields, HTMLElement>} */
  const labels = new Map();
  /** @param {keyof Fields} name @param {string} text @param {HTMLInputElement | HTMLSelectElement} input */
  const add = (name, text, input) => {
    const label = make("label", text + " ");
    input.value = fields[name];
    input.oninput = () => { fields[name] = input.value; show(); };
    label.append(input);
    form.append(label);
    labels.set(name, label);
    return input;
  };
  /** @param {[string, string][]} options */
  const select = options => {
    const element = /** @type {HTMLSelectElement} */ (make("select"));
    element.append(...options.map(([value, text]) => new Option(text, value)));
    return element;
  };
  const input = (size = 5) => {
    const element = /** @type {HTMLInputElement} */ (make("input"));
    element.type = "text";
    element.size = size;
    return element;
  };
  add("on", "Trigger", select(KINDS.map(([on, text]) => [on, text])));
  const probe = /** @type {HTMLSelectElement} */ (add("probe", "of", select([])));
  add("level", "level", input());
  add("low", "from", input());
  add("high", "to", input());
  add("equals", "state", input(10));
  add("source", "of", input(10));
  add("pre", "before s", input(4));
  add("post", "after s", input(4));
  add("mode", "mode", select(MODES));
  const button = /** @type {HTMLButtonElement} */ (make("button", "Arm"));
  form.append(button);
  form.onsubmit = event => {
    event.preventDefault();
    try { apply(settingsOf(fields)); } catch (error) { fail(error instanceof Error ? error.message : String(error)); }
  };
  const show = () => {
    const [on, , needed] = KINDS.find(([on]) => on === fields.on) ?? KINDS[0];
    for (const [name, label] of labels) {
      if (name === "on") continue;
      const isTime = name === "pre" || name === "post" || name === "mode";
      label.hidden = isTime ? on === "none" : !needed.includes(name);
    }
    button.textContent = on === "none" ? "Roll" : "Arm";
  };
  show();
  return {
    form,
    /** Offers these probes. @param {string[]} names */
    offer: names => {
      if ([...probe.options].map(option => option.value).join() === names.join()) return;
      probe.replaceChildren(...names.map(name => new Option(name, name)));
      if (!names.includes(fields.probe)) fields.probe = names[0] ?? "";
      probe.value = fields.probe;
    },
  };
}
