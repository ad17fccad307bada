// Nets: the list, one of them with its values, actions and graph, and the rules between them.

import { button, figure, figures, list, make, note, section, span, state, swap, table } from "./dom.js";
import { NetGraph } from "./net_graph.js";
import { drawRules } from "./rule_graph.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** Nets that are listed, the latest first. */
const LISTED_MAX = 200;
/** What can be requested, by state; others are in no state to be. */
const ACTIONS = /** @type {const} */ ([
  ["START", "start", ["READY"]], ["CANCEL", "cancel", ["RUNNING", "SCHEDULED"]],
  ["ABORT", "abort", ["RUNNING", "SCHEDULED", "CANCELLING", "READY"]], ["UNLOAD", "unload", ["READY", "TERMINATED", "REJECTED"]],
]);

/** @type {NetGraph | null} */
let graph = null;

/** @param {Json} net */
const nameOf = net => String(net.uri).split("/")[2];

/** Buttons of a net, those that its state permits. @param {App} app @param {string} name */
function actions(app, name) {
  const row = make("div", undefined, "row actions");
  const buttons = ACTIONS.map(([action, text, states]) => {
    const press = () => app.act(() => app.post("/nets/" + name + "/", { action }));
    return { element: button(text, press), states: /** @type {readonly string[]} */ (states) };
  });
  row.append(...buttons.map(it => it.element));
  let isOn = false, present = "";
  const update = () => buttons.forEach(({ element, states }) => { element.disabled = !isOn || !states.includes(present); });
  app.onControl(on => { isOn = on; update(); });
  return { row, show: (/** @type {string} */ word) => { present = word; update(); } };
}

/** Values of a net: what it gives, and fields for what it takes. @param {App} app @param {string} name */
function values(app, name) {
  const box = make("div");
  /** @type {Map<string, HTMLElement>} */
  const shown = new Map();
  let keys = "";
  /** @param {Json[]} data */
  const show = data => {
    const now = data.map(it => it.key).join(" ");
    if (now !== keys) {
      keys = now;
      shown.clear();
      swap(box, table(["value", "", ""], data.map(({ key }) => {
        const text = make("span", "", "value");
        shown.set(key, text);
        return { cells: [key, text, String(key).startsWith("in") ? field(app, name, String(key)) : ""] };
      }), "no values"));
    }
    for (const { key, text } of data) {
      const element = shown.get(key);
      if (element) element.textContent = text ?? "null";
    }
  };
  return { box, show };
}

/** A field that writes a value of a net. @param {App} app @param {string} name @param {string} key */
function field(app, name, key) {
  const form = /** @type {HTMLFormElement} */ (make("form", undefined, "row")), input = /** @type {HTMLInputElement} */ (make("input"));
  const set = /** @type {HTMLButtonElement} */ (make("button", "set"));
  [input.type, input.size] = ["text", 10];
  input.setAttribute("aria-label", "New value of " + key);
  app.onControl(on => { input.disabled = set.disabled = !on; });
  form.onsubmit = event => {
    event.preventDefault();
    app.act(() => app.post("/nets/" + name + "/", { [key]: input.value }));
  };
  form.append(input, set);
  return form;
}

/** Cost and times of a net. @param {Json} stats */
function cost(stats) {
  const modules = list(stats, "module"), own = list(modules[0], "exec")[0], all = list(stats, "figures")[0];
  if (!own || !all) return figures();
  const over = Number(all.overbudget);
  return figures(figure("period", span(all.period)), figure("cycles", all.cycles), figure("primitives", all.primitives),
    figure("declared cost", span(all.cost)), figure("measured mean", span(own.mean)), figure("measured max", span(own.max)),
    figure("budget", span(all.budget)), figure("over budget", over, over ? "warn" : "good"));
}

/** @param {App} app @param {HTMLElement} box @param {string} name */
function openNet(app, box, name) {
  const head = make("h2", name), pill = make("span"), notes = make("div"), times = make("div");
  const acts = actions(app, name), data = values(app, name);
  const link = make("a", "text");
  link.setAttribute("href", "/nets/" + encodeURIComponent(name) + "/dio");
  const row = make("div", undefined, "row");
  row.append(pill, acts.row, link);
  const drawn = graph = new NetGraph(app, name);
  const details = make("details"), summary = make("summary", "values");
  details.setAttribute("open", "");
  details.append(summary, data.box);
  swap(box, head, row, notes, times, details, make("h3", "Graph"), ...drawn.elements);
  drawn.open().catch(error => { drawn.note.textContent = error.message; });
  return async () => {
    const path = "/nets/" + encodeURIComponent(name) + "/", net = await app.get(path);
    head.textContent = name + (net.desc ? " — " + net.desc : "");
    swap(pill, state(net.status));
    acts.show(net.status);
    data.show(list(net, "data"));
    const lines = [];
    if (net.end) lines.push(make("p", "Ended: " + net.end, "note warn"));
    if (net.last) {
      const link = make("a", "values of its last second (CSV)");
      link.setAttribute("href", net.last);
      lines.push(link);
    }
    lines.push(...list(net, "rejected").map(it => note("rejected", it)), ...list(net, "errorState").map(it => make("p", it.text, "note bad")));
    swap(notes, ...lines);
    swap(times, await app.get(path + "stats").then(cost, () => figures()));
  };
}

/** Nets of a rule as texts that open them. @param {App} app @param {Json} rule @param {string} part */
function netsOf(app, rule, part) {
  const box = make("span");
  list(rule, part).forEach(({ net }, number) => box.append(number ? ", " : "", anchor(app, String(net))));
  return box;
}

/** @param {App} app @param {string} net */
function anchor(app, net) {
  const link = make("a", net);
  link.setAttribute("href", "#nets/" + encodeURIComponent(net));
  return link;
}

/** Replaces the picture of rules if it has changed; where it is scrolled to stays. @param {HTMLElement} box @param {Json[]} rules
 * @param {Map<string, { status: string, desc: string }>} nets */
function showRules(box, rules, nets) {
  const place = box.querySelector(".picture")?.scrollLeft ?? 0;
  swap(box, make("h2", "Rules between nets"), ...drawRules(rules, nets));
  const picture = box.querySelector(".picture");
  if (picture) picture.scrollLeft = place;
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const nets = section("Nets", "third"), rules = section("Rules", "third"), detail = section("", "detail"), drawn = section("");
  const left = make("div", undefined, "third stack"), right = make("div", undefined, "two-thirds stack");
  left.append(nets, rules);
  right.append(drawn, detail);
  [nets.id, rules.id, detail.id, drawn.id] = ["nets", "rules", "net", "rule-graph"];
  drawn.hidden = true;
  element.append(left, right);
  let opened = "";
  /** @type {() => Promise<void>} */
  let update = async () => {};
  app.every(500, async () => {
    const all = list(await app.get("/nets/"), "net"), names = all.map(nameOf);
    const picked = app.picked()[0] ?? nameOf(all.findLast(net => net.status === "RUNNING") ?? all.at(-1) ?? { uri: "///" });
    const rows = all.slice(-LISTED_MAX).reverse().map(net => {
      const name = nameOf(net);
      return { cells: [name, state(net.status), net.desc], pick: () => app.go("nets", name), isPicked: name === picked };
    });
    swap(nets, make("h2", "Nets"), table(["net", "state", "description"], rows, "no nets"));
    const states = new Map(list(await app.get("/rules/"), "rule").map(rule => [rule.id, rule]));
    swap(rules, make("h2", "Rules"), table(["when", "stop, cancel", "start", "state"], [...states.values()].slice(-LISTED_MAX).reverse().map(rule => {
      const ends = make("span");
      ends.append(netsOf(app, rule, "stop"), " ", netsOf(app, rule, "cancel"));
      const word = state(rule.state);
      word.title = rule.why ?? rule.desc ?? "";
      return { cells: [{ value: rule.condition }, ends, netsOf(app, rule, "start"), word] };
    }), "no rules between these nets"));
    drawn.hidden = !states.size;
    const known = new Map(all.map(net => [nameOf(net), { status: String(net.status), desc: String(net.desc ?? "") }]));
    if (states.size) showRules(drawn, [...states.values()], known);
    if (!names.includes(picked)) {
      graph?.close();
      opened = "";
      swap(detail, make("p", picked ? picked + " is not loaded any more" : "Programs load nets; the one that you pick is shown here.", "dim"));
      return;
    }
    if (picked !== opened) {
      graph?.close();
      opened = picked;
      update = openNet(app, detail, picked);
    }
    await update();
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "nets", title: "Nets", mount, unmount() { graph?.close(); graph = null; } };
