// Machines: one with its graph and present states, components and variables; actions, events and text commands.

import { button, figure, figures, list, make, section, span, state, swap, table } from "./dom.js";
import { Picture } from "./svg.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

const ACTIONS = [["START", "start"], ["STOP", "stop"], ["PAUSE", "pause"], ["STEP", "step"], ["END", "end"]];

/** Actions, events, operations of components, and a line for any other command. @param {App} app @param {string} path @param {Json} machine */
function commands(app, path, machine) {
  const box = make("div"), row = make("div", undefined, "row"), events = make("div", undefined, "row");
  const form = /** @type {HTMLFormElement} */ (make("form", undefined, "row"));
  const input = /** @type {HTMLInputElement} */ (make("input"));
  input.type = "text";
  input.placeholder = "servo.gain := 2; raise abort";
  input.setAttribute("aria-label", "Text commands");
  /** @param {string} command */
  const call = command => app.act(() => app.post(path, { command }));
  row.append(...ACTIONS.map(([action, text]) => button(text, () => app.act(() => app.post(path, { action })))));
  events.append(make("span", "events", "dim"), ...list(machine, "event").map(event => button(event.name, () => call("raise " + event.name))));
  for (const component of list(machine, "component")) {
    for (const operation of list(component, "operation")) {
      const name = component.name + "." + operation.name;
      // One with arguments goes into the line, to be completed.
      events.append(button(name + "(" + operation.arguments + ")", () => {
        if (operation.arguments) { input.value = name + "(" + operation.arguments + ")"; input.focus(); }
        else call(name + "()");
      }));
    }
  }
  form.append(input, make("button", "send"));
  form.onsubmit = event => { event.preventDefault(); call(input.value); };
  box.append(row, events, form);
  app.onControl(on => {
    for (const element of box.querySelectorAll("button, input")) /** @type {HTMLButtonElement} */ (element).disabled = !on;
  });
  return box;
}

/** How long states have lasted, as far as this page saw them begin. */
class Since {
  constructor() {
    /** @type {Map<string, { state: string, at: number, isExact: boolean }>} */
    this.known = new Map();
  }

  /** @param {string} machine @param {string} state */
  text(machine, state) {
    const before = this.known.get(machine), now = performance.now();
    if (!before || before.state !== state) this.known.set(machine, { state, at: now, isExact: !!before });
    const { at, isExact } = /** @type {{ at: number, isExact: boolean }} */ (this.known.get(machine));
    return (isExact ? "" : "≥ ") + ((now - at) / 1000).toFixed(1) + " s";
  }
}

/** @param {App} app @param {HTMLElement} box @param {string} name */
function openMachine(app, box, name) {
  const path = "/machines/" + encodeURIComponent(name) + "/", since = new Since(), picture = new Picture();
  const [head, states, figuresBox, components, variables, acts] = [make("h2", name), make("div"), make("div"), make("div"), make("div"), make("div")];
  const link = make("a", "text");
  link.setAttribute("href", path + "text");
  swap(box, head, acts, states, make("h3", "Graph"), picture.bar, picture.view, figuresBox, make("h3", "Components"), components,
    make("h3", "Variables"), variables, link);
  let inside = "", drawn = "", isFirst = true;
  return async () => {
    const machine = await app.get(path), all = list(machine, "machine");
    if (isFirst) { swap(acts, commands(app, path, machine)); isFirst = false; }
    swap(head, name + " ", state(machine.status));
    const rows = all.map((it, number) => ({
      cells: [it.name, state(it.status), it.mode + (it.paused === "true" ? ", paused" : ""), make("b", it.state), make("span", since.text(it.name, it.state), "figure"), it.text ?? ""],
      pick: () => { inside = number ? it.name : ""; }, isPicked: inside === (number ? it.name : ""),
    }));
    swap(states, table(["machine", "status", "mode", "state", "for", "last error"], rows, "no states"));
    const shown = all.find(it => it.name === inside) ?? all[0];
    const key = inside + " " + shown?.state;
    if (key !== drawn) {
      picture.show(await app.text(path + "graph" + (inside && "/" + encodeURIComponent(inside))), "States of " + (inside || name) + ", now " + shown?.state);
      drawn = key;
    }
    const it = list(machine, "figures")[0];
    if (it) swap(figuresBox, figures(figure("steps", it.steps), figure("transitions", it.transitions), figure("longest step", span(it.longest)),
      figure("declared step", span(it.step)), figure("declared components", span(it.components))));
    swap(components, table(["component", "phase", "net"], list(machine, "component").map(component => {
      const net = String(component.net ?? "").split("/")[2], open = make("a", net ?? "");
      open.setAttribute("href", "#nets/" + encodeURIComponent(net ?? ""));
      return { cells: [component.name, state(component.phase), net ? open : ""] };
    }), "no components"));
    swap(variables, table(["variable", "value"], list(machine, "variable").map(variable => ({ cells: [variable.name, { value: variable.text ?? "" }] })), "no variables"));
  };
}

/** The state of a machine, and those of the active machines inside, a line each. @param {Json} machine */
function nested(machine) {
  const box = make("span", machine.state), active = list(machine, "machine").filter(it => it.state);
  for (const { name, state: inside } of active) box.append(make("div", name + ": " + inside, "dim"));
  return box;
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const machines = section("Machines", "third"), detail = section("", "two-thirds detail");
  [machines.id, detail.id] = ["machines", "machine"];
  element.append(machines, detail);
  let opened = "";
  /** @type {() => Promise<void>} */
  let update = async () => {};
  app.every(250, async () => {
    const all = list(await app.get("/machines/"), "machine"), picked = app.picked()[0] ?? all[0]?.name ?? "";
    swap(machines, make("h2", "Machines"), table(["machine", "status", "state"], all.map(machine =>
      ({ cells: [machine.name, state(machine.status), nested(machine)], pick: () => app.go("machines", machine.name), isPicked: machine.name === picked })),
    "no machines"));
    if (!all.some(machine => machine.name === picked)) {
      opened = "";
      swap(detail, make("p", picked ? picked + " is not loaded any more" : "`takt machine load` loads one; its graph is shown here.", "dim"));
      return;
    }
    if (picked !== opened) {
      opened = picked;
      update = openMachine(app, detail, picked);
    }
    await update();
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "machines", title: "Machines", mount, unmount() {} };
