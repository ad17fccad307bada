// Draws the cell: floor, devices, commanded ghosts, frames, trails, forces. Where things are comes from `Places`.

import { Places, differs, reach } from "./geometry.js";
import { add, apply, beside, direct, identity, length, multiply, shift, unit } from "./math3.js";
import { piecesOf } from "./meshes.js";
import { Mesh, arrow, grid } from "./solids.js";

/** @typedef {import("./math3.js").Matrix} Matrix */
/** @typedef {import("./math3.js").Vector} Vector */
/** @typedef {import("./geometry.js").Geometry} Geometry */
/** @typedef {import("./geometry.js").Device} Device */
/** @typedef {import("./geometry.js").Live} Live */
/** @typedef {import("./webgl.js").Renderer} Renderer */
/** @typedef {import("./webgl.js").Drawn} Drawn */
/** @typedef {{ ghost: boolean, trail: boolean, frames: boolean, labels: boolean, force: boolean }} Shown */
/** @typedef {{ text: string, at: Vector, kind: string }} Label */
/** @typedef {{ link: number, role: string, mesh: Drawn, slide: Vector | null, pose: Matrix | null }} Part */

/** What is in a picture: where the tool of each ghost and that of its arm are, points of each trail, size of each force, N, and the objects.
 * @typedef {{ ghosts: { [device: string]: { at: Vector, measured: Vector } }, trails: { [device: string]: number }, forces: { [device: string]: number }, objects: string[] }} Contents */

/** Positions of a tool that are kept: some seconds at the rate of the display. */
const TRAIL_MAX = 600;
/** Positions of a tool closer than this are one, m. */
const TRAIL_STEP = 0.001;
/** Length of a force arrow, m/N, its shortest force, N, and its longest length, m. */
const FORCE_SCALE = 0.01, FORCE_MIN = 0.5, FORCE_MAX = 0.6;
/** Length of the axes of a frame, m. */
const AXIS = 0.12;
const FLOOR = 4;
/** Simple solids of an arm that its own shapes replace. */
const STAND_INS = ["foot", "link", "joint", "flange", "notch"];

/** Colours of the device's links, one after the other, of light and dark pages alike. */
const DEVICES = [[0.93, 0.49, 0.15], [0.25, 0.55, 0.85], [0.35, 0.68, 0.42], [0.83, 0.68, 0.2], [0.62, 0.45, 0.8], [0.3, 0.68, 0.7]];
const ROLES = { joint: [0.42, 0.45, 0.5], flange: [0.72, 0.74, 0.77], notch: [0.85, 0.2, 0.18], tool: [0.75, 0.77, 0.8], finger: [0.75, 0.77, 0.8],
  foot: [0.3, 0.33, 0.37], wheel: [0.22, 0.23, 0.26] };
const AXES = [[0.86, 0.25, 0.22], [0.2, 0.65, 0.3], [0.25, 0.45, 0.95]];
const THEMES = {
  light: { back: [0.945, 0.953, 0.961], ambient: 0.62, thin: [0.87, 0.885, 0.9], metre: [0.78, 0.8, 0.825], ghost: [0.1, 0.4, 0.9], trail: [0.1, 0.45, 0.75], force: [0.8, 0.1, 0.25], object: [0.72, 0.7, 0.66] },
  dark: { back: [0.075, 0.09, 0.11], ambient: 0.42, thin: [0.125, 0.145, 0.17], metre: [0.19, 0.215, 0.245], ghost: [0.45, 0.7, 1], trail: [0.45, 0.75, 1], force: [1, 0.35, 0.45], object: [0.36, 0.37, 0.39] },
};

export class Scene {
  /** @param {Renderer} renderer @param {Geometry} geometry @param {Map<string, Matrix>} row */
  constructor(renderer, geometry, row) {
    this.renderer = renderer;
    this.geometry = geometry;
    this.row = row;
    /** @type {Drawn[]} */ this.loaded = [];
    const lines = grid(FLOOR);
    this.thin = this.keep(renderer.loadLines(lines.thin));
    this.metre = this.keep(renderer.loadLines(lines.metre));
    this.axes = [0, 1, 2].map(axis => this.keep(renderer.loadLines([0, 0, 0, ...[0, 1, 2].map(it => it === axis ? AXIS : 0)])));
    this.arrow = this.keep(renderer.load(arrow(renderer.isSoftware)));
    this.parts = new Map(geometry.devices.map(device => [device.name, this.partsOf(device)]));
    this.objects = geometry.objects.map(object => {
      const mesh = new Mesh(renderer.isSoftware);
      object.solids.forEach(solid => mesh.solid(solid));
      return { object, mesh: this.keep(renderer.load(mesh)) };
    });
    /** @type {Map<string, { points: Float32Array, count: number, lines: Drawn }>} */
    this.trails = new Map();
    /** @type {Contents} */
    this.contents = { ghosts: {}, trails: {}, forces: {}, objects: [] };
  }

  /** @param {Drawn} drawn */
  keep(drawn) {
    this.loaded.push(drawn);
    return drawn;
  }

  /** Frees what lies in the memory of the graphics processor. */
  release() {
    this.clearTrails();
    this.loaded.forEach(drawn => this.renderer.release(drawn));
  }

  /** One mesh for all solids of a link that have one colour. @param {Device} device @returns {Part[]} */
  partsOf(device) {
    /** @type {Map<string, { link: number, role: string, slide: Vector | null, mesh: Mesh }>} */
    const parts = new Map();
    // Simple solids stand for a link whose own shapes are not all there.
    const shapes = device.solids.filter(solid => solid.role === "visual"), isKnown = (/** @type {import("./geometry.js").Solid} */ solid) => solid.kind !== "mesh" || !!piecesOf(solid);
    const shown = new Set(shapes.map(solid => solid.link).filter(link => shapes.every(solid => solid.link !== link || isKnown(solid))));
    /** @type {Part[]} */
    const meshes = [];
    for (const solid of device.solids) {
      if (STAND_INS.includes(solid.role) && shown.has(solid.link)) continue;
      if (solid.role === "visual" && !shown.has(solid.link)) continue;
      if (solid.kind === "mesh") {
        for (const piece of piecesOf(solid) ?? [])
          meshes.push({ link: solid.link, role: solid.role, slide: null, pose: solid.pose, mesh: this.keep(this.renderer.load(piece)) });
        continue;
      }
      const key = [solid.link, solid.role, solid.slide].join();
      const part = parts.get(key) ?? { link: solid.link, role: solid.role, slide: solid.slide, mesh: new Mesh(this.renderer.isSoftware) };
      part.mesh.solid(solid);
      parts.set(key, part);
    }
    return [...meshes, ...[...parts.values()].map(part => ({ ...part, pose: null, mesh: this.keep(this.renderer.load(part.mesh)) }))];
  }

  /** Remembers where the tools are. @param {Places} places */
  trace(places) {
    for (const device of this.geometry.devices) {
      if (!device.isArm || !places.live.get(device.name)?.joints.length) continue;
      const tip = places.tip(device);
      if (tip) this.extend(device.name, [tip[12], tip[13], tip[14]]);
    }
  }

  /** @param {string} name @param {Vector} point */
  extend(name, point) {
    let trail = this.trails.get(name);
    if (!trail) {
      trail = { points: new Float32Array(3 * TRAIL_MAX), count: 0, lines: this.renderer.loadLines([]) };
      this.trails.set(name, trail);
    }
    const { points, count } = trail, last = 3 * (count - 1);
    if (count && Math.hypot(point[0] - points[last], point[1] - points[last + 1], point[2] - points[last + 2]) < TRAIL_STEP) return;
    if (count === TRAIL_MAX) points.copyWithin(0, 3);
    else trail.count++;
    points.set(point, 3 * (trail.count - 1));
    this.renderer.replaceLines(trail.lines, points.subarray(0, 3 * trail.count));
  }

  clearTrails() {
    for (const { lines } of this.trails.values()) this.renderer.release(lines);
    this.trails.clear();
  }

  /** Draws a picture. @param {import("./camera.js").Camera} camera @param {Places} places @param {Shown} shown @param {boolean} isDark
   * @returns {Label[]} */
  draw(camera, places, shown, isDark) {
    const { renderer } = this, theme = isDark ? THEMES.dark : THEMES.light;
    const aspect = renderer.canvas.clientWidth / Math.max(1, renderer.canvas.clientHeight);
    renderer.begin(camera.matrix(aspect), camera.eye, theme.back, theme.ambient);
    // The floor is behind everything; lines that begin behind the camera have depths that not every driver computes well.
    renderer.hide(false);
    renderer.drawLines(this.thin, identity(), theme.thin);
    renderer.drawLines(this.metre, identity(), theme.metre);
    renderer.hide(true);
    /** @type {Label[]} */
    const labels = [];
    this.contents = { ghosts: {}, trails: {}, forces: {}, objects: [] };
    this.geometry.devices.forEach((device, number) => {
      const live = places.live.get(device.name);
      this.device(device, places.links(device), live, role => this.colour(role, number), 1);
      const force = shown.force && live?.force && this.force(device, live.force, places, theme.force);
      if (force) labels.push(force);
      if (shown.labels) labels.push(...this.name(device, places));
    });
    labels.push(...this.drawObjects(places, theme.object, shown.labels));
    if (shown.frames) labels.push(...this.frames(places, shown.labels));
    if (shown.trail)
      for (const [name, { lines, count }] of this.trails) {
        renderer.drawLines(lines, identity(), theme.trail, 1, true);
        this.contents.trails[name] = count;
      }
    if (shown.ghost) this.ghosts(places, theme.ghost);
    return labels;
  }

  /** The objects of the cell, with their names in their middles. @param {Places} places @param {number[]} colour @param {boolean} isLabelled
   * @returns {Label[]} */
  drawObjects(places, colour, isLabelled) {
    /** @type {Label[]} */
    const labels = [];
    for (const { object, mesh } of this.objects) {
      const at = places.object(object);
      if (!at) continue;
      this.renderer.draw(mesh, at, colour);
      this.contents.objects.push(object.name);
      if (isLabelled) labels.push({ text: object.name, at: [at[12], at[13], at[14]], kind: "object" });
    }
    return labels;
  }

  /** @param {string} role @param {number} number of the device */
  colour(role, number) {
    return ROLES[/** @type {keyof typeof ROLES} */ (role)] ?? DEVICES[number % DEVICES.length];
  }

  /** @param {Device} device @param {Matrix[] | null} links @param {Live | undefined} live @param {(role: string) => number[]} colour
   * @param {number} alpha */
  device(device, links, live, colour, alpha) {
    if (!links) return;
    for (const { link, role, mesh, slide, pose } of this.parts.get(device.name) ?? []) {
      let at = links[link] ?? links[0];
      if (pose) at = multiply(at, pose);
      if (slide) at = add3(at, slide, live?.opening ?? 0);
      this.renderer.draw(mesh, at, colour(role), alpha);
    }
  }

  /** Arms where they are commanded to be. @param {Places} places @param {number[]} colour */
  ghosts(places, colour) {
    const commanded = new Places(this.geometry, this.row, places.live, "commanded");
    for (const device of this.geometry.devices) {
      const live = places.live.get(device.name);
      if (!live || !differs(live)) continue;
      this.device(device, commanded.links(device), live, () => colour, 0.35);
      const tip = commanded.tip(device), measured = places.tip(device);
      if (tip && measured) this.contents.ghosts[device.name] = { at: [...tip.subarray(12, 15)], measured: [...measured.subarray(12, 15)] };
    }
  }

  /** @param {Device} device @param {number[]} force in the flange, N @param {Places} places @param {number[]} colour @returns {Label | null} */
  force(device, force, places, colour) {
    const flange = places.frame(device.name + ".flange"), size = length(force);
    if (!flange || !(size >= FORCE_MIN)) return null;
    const long = Math.min(FORCE_MAX, size * FORCE_SCALE), z = unit(direct(flange, force)), [x, y] = beside(z), from = [...flange.subarray(12, 15)];
    const scaled = Float64Array.from([...x.map(v => v * 0.3), 0, ...y.map(v => v * 0.3), 0, ...z.map(v => v * long), 0, ...from, 1]);
    this.renderer.draw(this.arrow, scaled, colour);
    this.contents.forces[device.name] = size;
    return { text: size.toPrecision(3) + " N", at: add(from, z, long), kind: "force" };
  }

  /** The name of a device above it. @param {Device} device @param {Places} places @returns {Label[]} */
  name(device, places) {
    const links = device.solids.length ? places.links(device) : null;
    if (!links) return [];
    const base = links[0];
    const end = device.isArm ? places.frame(device.name + ".flange") : null;
    // Beside its foot, as the arm moves above.
    const at = end ? apply(base, [0, 0, -0.04]) : apply(base, [0, 0, reach(device) * 0.9]);
    return [{ text: device.name + (device.parent === null ? " *" : ""), at, kind: "device" }];
  }

  /** World, named frames, flanges and tools. @param {Places} places @param {boolean} isLabelled @returns {Label[]} */
  frames(places, isLabelled) {
    const named = this.geometry.frames.map(frame => frame.name);
    const tools = this.geometry.devices.flatMap(device => device.isArm ? [device.name + "." + (device.tools[0]?.name ?? "flange")] : []);
    /** @type {Label[]} */
    const labels = [];
    for (const name of ["world", ...named, ...tools]) {
      const at = places.frame(name);
      if (!at) continue;
      this.axes.forEach((line, axis) => this.renderer.drawLines(line, at, AXES[axis]));
      if (isLabelled && !name.includes(".")) labels.push({ text: name, at: [at[12], at[13], at[14]], kind: "frame" });
    }
    return labels;
  }

  /** The corners of a box around all devices and objects. @param {Places} places @returns {[Vector, Vector]} */
  bounds(places) {
    const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 0.3];
    for (const device of this.geometry.devices) {
      const links = places.links(device);
      for (const solid of links ? device.solids : []) {
        const ends = solid.kind === "box" ? [apply(solid.pose, [0, 0, 0])] : [solid.from, solid.to];
        for (const end of ends) {
          const at = apply(/** @type {Matrix[]} */ (links)[solid.link] ?? shift([0, 0, 0]), end);
          at.forEach((value, axis) => { low[axis] = Math.min(low[axis], value - 0.1); high[axis] = Math.max(high[axis], value + 0.1); });
        }
      }
    }
    for (const { object } of this.objects) {
      const at = places.object(object);
      at?.subarray(12, 15).forEach((value, axis) => { low[axis] = Math.min(low[axis], value - 0.1); high[axis] = Math.max(high[axis], value + 0.1); });
    }
    return Number.isFinite(low[0]) ? [low, high] : [[-1, -1, 0], [1, 1, 1]];
  }
}

/** A pose, shifted along a direction of its own. @param {Matrix} at @param {Vector} along @param {number} far */
function add3(at, along, far) {
  const moved = at.slice(), shifted = apply(at, along.map(value => value * far));
  moved.set(shifted, 12);
  return moved;
}
