// The cell in three dimensions, as its devices measure it now.

import { list, make, section } from "./dom.js";
import { Camera, connectCamera } from "./camera.js";
import { Places, atRest, readGeometry, rowOf } from "./geometry.js";
import { length, project } from "./math3.js";
import { periods, readProbe } from "./live.js";
import { readMeshes } from "./meshes.js";
import { Scene } from "./scene.js";
import { Scopes } from "./scopes.js";
import { Renderer } from "./webgl.js";

/** @typedef {import("./api.js").App} App */
/** @typedef {import("./geometry.js").Live} Live */
/** @typedef {import("./geometry.js").Geometry} Geometry */
/** @typedef {import("./scene.js").Shown} Shown */

/** Pictures and samples per second, and the table. */
const RATE_HZ = 60, TABLE_MS = 250;
/** Below this rate, pictures get less detail. */
const RATE_MIN_HZ = 32;
/** Interval at which devices are looked for, ms. */
const CELL_MS = 3000;
/** Labels that are shown at once. */
const LABELS_MAX = 80;
/** Roughly the width of a letter of a label and the height of its line, pixels, and how far labels give way to others, lines. */
const LETTER_PX = 7, LINE_PX = 14, PUSHES_MAX = 10;

/** What can be shown: name, text, key. @type {[keyof Shown, string][]} */
const SWITCHES = [["ghost", "commanded ghost"], ["trail", "trail"], ["force", "forces"], ["frames", "frames"], ["labels", "labels"]];

/** Kept while other views are open. */
const camera = new Camera();
/** @type {Shown} */
const shown = { ghost: true, trail: true, frames: true, labels: true, force: true };
let hasFitted = false;

/** The mounted view. */
class Mounted {
  /** @param {HTMLElement} element @param {App} app */
  constructor(element, app) {
    this.app = app;
    this.canvas = /** @type {HTMLCanvasElement} */ (make("canvas", undefined, "space"));
    this.labels = make("div", undefined, "space-labels");
    this.state = make("span", "", "dim");
    this.rate = make("span", "", "dim");
    this.table = make("div");
    this.unread = make("p", "", "warn plot-note");
    /** @type {Geometry} */ this.geometry = { frames: [], devices: [], objects: [] };
    /** @type {Map<string, import("./math3.js").Matrix>} */ this.row = new Map();
    /** @type {Map<string, Live>} */ this.live = new Map();
    /** @type {Scene | null} */ this.scene = null;
    /** @type {Scopes[]} */ this.scopes = [];
    /** @type {string[]} */ this.known = ["", ""];
    this.hasChanged = true;
    this.isOver = false;
    this.frames = 0;
    this.busy = 0;
    this.calm = 0;
    this.calmNeeded = 3;
    this.counted = { at: performance.now(), frames: 0 };
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    /** @type {Renderer | null} */ this.renderer = null;
    const box = make("div", undefined, "space-box");
    element.append(section("Cell", "", this.toolbar(), box, make("p", "", "dim space-note"), this.unread, this.table));
    this.note = /** @type {HTMLElement} */ (element.querySelector(".space-note"));
    try {
      this.renderer = new Renderer(this.canvas);
    } catch (error) {
      box.append(make("p", error instanceof Error ? error.message : String(error), "bad"));
      box.classList.add("empty");
    }
    if (this.renderer) this.show(box);
    app.every(CELL_MS, () => this.readCell());
    app.every(TABLE_MS, () => this.showTable());
  }

  /** @param {HTMLElement} box */
  show(box) {
    const changed = () => { this.hasChanged = true; };
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("aria-label", "The cell. Arrow keys turn, with Shift they move, + and - zoom, f shows all.");
    box.append(this.canvas, this.labels);
    connectCamera(this.canvas, camera, changed, () => this.fit());
    this.dark.onchange = changed;
    this.watch = new ResizeObserver(changed);
    this.watch.observe(this.canvas);
    this.canvas.addEventListener("webglcontextlost", event => { event.preventDefault(); this.scene = null; });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.renderer = new Renderer(this.canvas);
      this.build();
    });
    const picture = () => {
      if (this.isOver) return;
      requestAnimationFrame(picture);
      if (this.hasChanged && this.scene) this.draw();
    };
    requestAnimationFrame(picture);
  }

  toolbar() {
    const bar = make("div", undefined, "row");
    for (const [name, text] of SWITCHES) {
      const label = make("label"), box = /** @type {HTMLInputElement} */ (make("input"));
      box.type = "checkbox";
      box.checked = shown[name];
      box.onchange = () => { shown[name] = box.checked; this.hasChanged = true; };
      label.append(box, " " + text);
      bar.append(label);
    }
    const button = (/** @type {string} */ text, /** @type {() => void} */ press) => {
      const element = make("button", text);
      element.onclick = () => { press(); this.hasChanged = true; };
      bar.append(element);
    };
    button("Show all", () => this.fit());
    button("Clear trails", () => this.scene?.clearTrails());
    button("Save picture", () => this.save());
    bar.append(this.state, this.rate);
    return bar;
  }

  save() {
    // The browser keeps what was drawn until this task ends.
    this.draw();
    const link = /** @type {HTMLAnchorElement} */ (make("a"));
    link.href = this.canvas.toDataURL("image/png");
    link.download = "cell.png";
    link.click();
  }

  places() {
    return new Places(this.geometry, this.row, this.live);
  }

  fit() {
    if (!this.scene) return;
    const [low, high] = this.scene.bounds(this.places());
    camera.fit(low, high, this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight));
    this.hasChanged = true;
  }

  /** Reads what the cell has, and asks for its values again if that has changed. */
  async readCell() {
    const reading = this.app.get("/probes/").catch(error => ({ error: String(error) })), geometry = await this.app.get("/geometry/");
    if (this.isOver) return;
    const shape = JSON.stringify(geometry);
    // The list of probes is long: the cell is drawn before it is here.
    if (shape !== this.known[0]) {
      this.geometry = readGeometry(geometry);
      this.row = rowOf(this.geometry);
      this.build();
      this.readMeshes();
    }
    const probes = await reading;
    if (this.isOver) return;
    const texts = [shape, JSON.stringify(list(probes, "probe").map(probe => probe.name))];
    if (texts.join() !== this.known.join()) this.watchProbes(list(probes, "probe"));
    if (probes.error) this.showState(probes.error, false);
    this.known = texts;
  }

  /** Draws meshes when they are read; simple solids stand for them until then. */
  async readMeshes() {
    const { geometry } = this, meshes = geometry.devices.flatMap(device => device.solids).filter(solid => solid.kind === "mesh");
    if (!meshes.length) { this.unread.textContent = ""; return; }
    const faults = await readMeshes(meshes);
    if (this.isOver || geometry !== this.geometry) return;
    this.unread.textContent = faults.length ? "Drawn as simple solids:\n" + faults.join("\n") : "";
    this.canvas.dataset.meshes = String(meshes.length - faults.length);
    this.build();
  }

  build() {
    this.scene?.release();
    this.scene = this.renderer && new Scene(this.renderer, this.geometry, this.row);
    const loose = this.row.size ? "* The cell file does not place this device; it stands where there is room. " : "";
    this.note.textContent = loose + "Drag: turn. Shift or right button: move. Wheel: zoom. Keys: arrows, + − f. Red, green, blue: x, y, z.";
    if (!hasFitted && this.geometry.devices.length) { this.fit(); hasFitted = true; }
    this.hasChanged = true;
  }

  /** @param {import("./dom.js").Json[]} probes */
  watchProbes(probes) {
    this.scopes.forEach(scope => scope.close());
    this.live = new Map(this.geometry.devices.map(device => [device.name, atRest()]));
    // A request has one divisor, and each thread has a period of its own.
    this.scopes = periods(probes, this.geometry, RATE_HZ).map(query => {
      /** @type {((value: number) => void)[][]} */
      let setters = [];
      const scope = new Scopes({
        groups: groups => { setters = groups.map(group => group.probes.map(probe => readProbe(probe.name, this.live))); },
        samples: ({ group, rows, columns, data }) => {
          if (!rows) return;
          const last = (rows - 1) * (columns + 1) + 1;
          setters[group].forEach((set, column) => set(data[last + column]));
          this.hasChanged = true;
        },
        state: (text, isGood) => this.showState(text, isGood),
      });
      scope.ask({ ...query, rate_hz: RATE_HZ });
      return scope;
    });
    if (!this.scopes.length) this.showState(this.geometry.devices.length ? "no probes of these devices" : "no devices", false);
  }

  /** @param {string} text @param {boolean} isGood */
  showState(text, isGood) {
    this.state.textContent = text;
    this.state.className = isGood ? "good" : "warn";
  }

  draw() {
    const { scene } = this;
    if (!scene || !this.canvas.clientWidth) return;
    this.hasChanged = false;
    const places = this.places();
    if (shown.trail) scene.trace(places);
    this.place(scene.draw(camera, places, shown, this.dark.matches));
    this.busy++;
    this.canvas.dataset.frames = String(++this.frames);
    this.canvas.dataset.contents = JSON.stringify(scene.contents);
  }

  /** @param {import("./scene.js").Label[]} labels */
  place(labels) {
    const { clientWidth: width, clientHeight: height } = this.canvas, view = camera.matrix(width / Math.max(1, height));
    /** @type {number[][]} */
    const taken = [];
    const visible = labels.slice(0, LABELS_MAX).flatMap(label => {
      const at = project(view, label.at);
      if (!at || !(Math.abs(at[0]) < 1 && Math.abs(at[1]) < 1)) return [];
      // Below those that are there already.
      const x = (at[0] + 1) / 2 * width, wide = LETTER_PX * label.text.length;
      let y = (1 - at[1]) / 2 * height;
      for (let round = 0; round < PUSHES_MAX; round++) {
        const below = taken.find(([left, top, right]) => left < x + wide && x < right && Math.abs(top - y) < LINE_PX);
        if (!below) break;
        y = below[1] + LINE_PX;
      }
      taken.push([x, y, x + wide]);
      return [{ label, x, y }];
    });
    while (this.labels.children.length < visible.length) this.labels.append(make("span"));
    while (this.labels.children.length > visible.length) this.labels.lastChild?.remove();
    visible.forEach(({ label, x, y }, number) => {
      const element = /** @type {HTMLElement} */ (this.labels.children[number]);
      if (element.textContent !== label.text) element.textContent = label.text;
      element.className = label.kind;
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    });
  }

  /** Less detail if pictures take too long although there is always something new, and more if they do not for a while: longer each time.
   * @param {number} rate_hz */
  adapt(rate_hz) {
    if (rate_hz < 2 || !this.renderer) return;
    this.calm = rate_hz > RATE_MIN_HZ ? this.calm + 1 : 0;
    if (!this.calm && this.renderer.coarsen()) this.calmNeeded *= 2;
    else if (this.calm > this.calmNeeded) { this.renderer.refine(); this.calm = 0; }
  }

  /** Positions of tools as numbers, for those who cannot see the picture too. */
  showTable() {
    const now = performance.now(), past = now - this.counted.at;
    if (past > 900) {
      this.adapt(this.busy * 1000 / past);
      this.busy = 0;
      this.rate.textContent = Math.round((this.frames - this.counted.frames) * 1000 / past) + " pictures/s";
      this.busy = 0;
      this.counted = { at: now, frames: this.frames };
    }
    const places = this.places();
    const rows = this.geometry.devices.filter(device => device.solids.length).map(device => {
      const live = this.live.get(device.name) ?? atRest(), at = device.isArm ? places.tip(device) : places.frame(device.name + ".base");
      const isKnown = device.isArm ? live.joints.some(Number.isFinite) : !device.mobile || live.base !== null;
      const position = at && isKnown ? [...at.subarray(12, 15)].map(value => value.toFixed(4)) : ["—", "—", "—"];
      const apart = Math.max(...live.commanded.map((value, n) => Math.abs(value - live.joints[n])).filter(Number.isFinite), -1);
      return [device.name, device.isArm ? device.tools[0]?.name ?? "flange" : "base", ...position,
        apart < 0 ? "—" : apart.toFixed(5), live.force ? length(live.force).toFixed(1) : "—"];
    });
    for (const object of this.geometry.objects) {
      const at = places.object(object);
      rows.push([object.name, "object", ...(at ? [...at.subarray(12, 15)].map(value => value.toFixed(4)) : ["—", "—", "—"]), "", ""]);
    }
    this.fill(["device", "frame", "x m", "y m", "z m", "largest joint error rad", "force N"], rows);
  }

  /** @param {string[]} heads @param {string[][]} rows */
  fill(heads, rows) {
    const table = /** @type {HTMLTableElement} */ (this.table.querySelector("table") ?? make("table"));
    if (table.rows.length !== rows.length + 1) {
      table.replaceChildren();
      const head = table.createTHead().insertRow(), body = table.createTBody();
      head.append(...heads.map((text, n) => make("th", text, n > 1 ? "number" : "")));
      for (const row of rows) row.forEach((_, n, { length }) => { if (!n) body.insertRow(); body.rows[body.rows.length - 1].insertCell().className = n > 1 && length ? "number" : ""; });
      this.table.replaceChildren(rows.length ? table : make("p", "no devices", "dim"));
    }
    rows.forEach((row, r) => row.forEach((text, n) => {
      const cell = table.rows[r + 1].cells[n];
      if (cell.textContent !== text) cell.textContent = text;
    }));
  }

  end() {
    this.isOver = true;
    this.watch?.disconnect();
    this.dark.onchange = null;
    this.scopes.forEach(scope => scope.close());
    this.scene?.release();
    // A browser has few contexts; a view that is gone keeps none.
    this.renderer?.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** @type {Mounted | null} */
let mounted = null;

/** @type {import("./api.js").View} */
export const view = {
  id: "cell",
  title: "Cell",
  mount: (element, app) => { mounted = new Mounted(element, app); },
  unmount: () => { mounted?.end(); mounted = null; },
};
