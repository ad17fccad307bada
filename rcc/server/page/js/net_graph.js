// A net as a live graph: its boxes and links take colours by what its ports have now, or by what its primitives cost.

import { list, make } from "./dom.js";
import { Picture } from "./svg.js";

/** @typedef {import("./api.js").App} App */
/** @typedef {{ element: Element, path: string, type: string, outs: string[], values: Map<string, number | null>, changed: number }} Box */

/** Most ports whose values are requested, so that other clients of the net have scopes left; of larger nets the first ones. */
const PORTS_MAX = 128;
/** The bits of null; other numbers that are none are the net's own. */
const NULL = 0x7ff86e756c6c0000n;
/** Frames of values a second. */
const RATE_HZ = 8;
/** A box is active for so long after a change of a value, ms. */
const ACTIVE_MS = 600;

/** Costs of primitives, ns for one evaluation, by type: the same for all nets. @type {Promise<Map<string, number>> | null} */
let costs = null;

/** @param {App} app */
async function readCosts(app) {
  const modules = list(await app.get("/modulesdetails/"), "module");
  return new Map(modules.map(module => [String(module.name), Number(module.firstns ?? 0) + Number(module.elementns ?? 0)]));
}

export class NetGraph {
  /** @param {App} app @param {string} net */
  constructor(app, net) {
    this.app = app;
    this.net = net;
    this.picture = new Picture();
    this.tip = make("div", undefined, "tip");
    this.tip.hidden = true;
    this.note = make("span", "", "dim");
    const choice = /** @type {HTMLSelectElement} */ (make("select"));
    choice.setAttribute("aria-label", "Colours");
    choice.append(...["values", "cost"].map(name => make("option", "colours: " + name)));
    choice.onchange = () => { this.byCost = choice.selectedIndex === 1; this.paint(); };
    this.picture.bar.append(choice, this.note);
    this.byCost = false;
    /** @type {Map<string, Box>} */ this.boxes = new Map();
    /** @type {Map<string, Element[]>} */ this.links = new Map();
    /** @type {Map<string, number>} */ this.costs = new Map();
    /** @type {{ close: () => void } | null} */ this.scope = null;
    /** Names of the columns of each group of samples. @type {string[][]} */ this.columns = [];
    this.isOver = false;
  }

  /** What is to be in the page. */
  get elements() { return [this.picture.bar, this.picture.view, this.tip]; }

  /** Draws it, and follows its values. */
  async open() {
    this.picture.show(await this.app.text("/nets/" + this.net + "/graph"), "Graph of " + this.net);
    costs ??= readCosts(this.app).catch(() => { costs = null; return new Map(); });
    this.costs = await costs;
    if (this.isOver || !this.picture.svg) return;
    for (const element of this.picture.svg.querySelectorAll("g.primitive")) {
      const [path, type] = [element.getAttribute("data-path") ?? "", element.getAttribute("data-type") ?? ""];
      const outs = (element.getAttribute("data-outs") ?? "").split(" ").filter(out => out);
      const box = { element, path, type, outs, values: new Map(), changed: 0 };
      this.boxes.set(path, box);
      element.addEventListener("pointermove", event => this.hover(box, /** @type {PointerEvent} */ (event)));
      element.addEventListener("pointerleave", () => { this.tip.hidden = true; });
    }
    for (const link of this.picture.svg.querySelectorAll("path[data-from]")) {
      const from = link.getAttribute("data-from") ?? "";
      this.links.set(from, [...(this.links.get(from) ?? []), link]);
    }
    this.paint();
    await this.follow();
  }

  close() {
    this.isOver = true;
    this.scope?.close();
  }

  /** Asks for the values of all connected out ports. */
  async follow() {
    const ports = [...this.boxes.values()].flatMap(box => box.outs.map(out => box.path + "." + out));
    const probes = ports.slice(0, PORTS_MAX).map(port => "net:" + this.net + "/" + port);
    if (!probes.length) return;
    const left = ports.length > PORTS_MAX ? "; values of the first " + PORTS_MAX + " ports" : "";
    const { Scopes } = await import("./scopes.js");
    if (this.isOver) return;
    const scope = new Scopes({
      groups: (groups, rejected) => {
        this.columns = groups.map(group => group.probes.map(probe => probe.name));
        const missing = rejected.length ? rejected.length + " ports without value" + (rejected[0].cause ? ": " + rejected[0].cause : "") : "live";
        this.note.textContent = missing + left;
      },
      samples: samples => this.take(samples),
      ended: () => { this.note.textContent = "ended: last values"; },
      state: (text, isGood) => { if (!isGood) this.note.textContent = "values: " + text; },
    });
    this.scope = scope;
    scope.ask({ probes, every: 20, rate_hz: RATE_HZ });
  }

  /** Takes the last row of samples. @param {import("./scope.js").Samples} samples */
  take(samples) {
    const names = this.columns[samples.group];
    if (!names || !samples.rows) return;
    const row = samples.data.subarray((samples.rows - 1) * (samples.columns + 1) + 1);
    const bits = new BigUint64Array(row.buffer, row.byteOffset, row.length);
    const now = performance.now(), start = ("net:" + this.net + "/").length;
    names.forEach((name, column) => {
      const found = this.find(name.slice(start));
      if (!found) return;
      const [box, port] = found, value = bits[column] === NULL ? null : row[column];
      if (!Object.is(box.values.get(port), value)) box.changed = now;
      box.values.set(port, value);
    });
    this.paint();
  }

  /** The box and the port, or the part of its value, of a probe. @param {string} name @returns {[Box, string] | null} */
  find(name) {
    for (let at = name.lastIndexOf("."); at > 0; at = name.lastIndexOf(".", at - 1)) {
      const box = this.boxes.get(name.slice(0, at));
      if (box) return [box, name.slice(at + 1)];
    }
    return null;
  }

  paint() {
    const now = performance.now(), most = Math.max(1, ...[...this.boxes.values()].map(box => this.costs.get(box.type) ?? 0));
    for (const box of this.boxes.values()) {
      const values = [...box.values.values()], { classList } = box.element;
      const cost = this.byCost ? Math.min(4, Math.ceil(4 * (this.costs.get(box.type) ?? 0) / most)) : 0;
      for (const level of [1, 2, 3, 4]) classList.toggle("cost" + level, cost === level);
      const isNull = (/** @type {number | null} */ value) => value === null;
      classList.toggle("is-null", !this.byCost && values.length > 0 && values.every(isNull));
      classList.toggle("is-partial", !this.byCost && values.some(isNull) && !values.every(isNull));
      classList.toggle("is-nan", !this.byCost && values.some(Number.isNaN));
      classList.toggle("is-active", !this.byCost && now - box.changed < ACTIVE_MS && box.changed > 0);
      for (const out of box.outs) {
        const isNull = [...box.values].some(([port, value]) => value === null && (port === out || port.startsWith(out + ".") || port.startsWith(out + "[")));
        for (const link of this.links.get(box.path + "." + out) ?? [])
          link.classList.toggle("is-null", !this.byCost && isNull);
      }
    }
  }

  /** @param {Box} box @param {PointerEvent} event */
  hover(box, event) {
    const cost = this.costs.get(box.type);
    const lines = [make("b", box.path), make("span", box.type + (cost === undefined ? "" : ", " + cost + " ns"), "dim")];
    for (const [port, value] of box.values)
      lines.push(make("span", port + " = " + (value === null ? "null" : Number.isNaN(value) ? "NaN" : Number(value.toPrecision(6)))));
    if (!box.values.size && box.outs.length) lines.push(make("span", "no values", "dim"));
    this.tip.replaceChildren(...lines);
    this.tip.hidden = false;
    const width = this.tip.offsetWidth, height = this.tip.offsetHeight;
    this.tip.style.left = Math.min(event.clientX + 14, innerWidth - width - 8) + "px";
    this.tip.style.top = Math.min(event.clientY + 14, innerHeight - height - 8) + "px";
  }
}
