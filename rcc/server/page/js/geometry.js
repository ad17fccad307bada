// The cell as `/geometry/` describes it, and where its frames and devices are for the present joint positions. It draws nothing.

import { apply, forward, identity, links, multiply, pose } from "./math3.js";

/** @typedef {import("./math3.js").Matrix} Matrix */
/** @typedef {import("./math3.js").Vector} Vector */
/** @typedef {import("./dom.js").Json} Json */
/** A solid of a device, in its base while all joints are at 0.
 * @typedef {{ link: number, role: string, kind: string, from: Vector, to: Vector, radius: number, pose: Matrix, size: Vector, slide: Vector | null, uri: string,
 *   file: string, scale: number[] }} Solid */
/** @typedef {{ name: string, type: string, serial: boolean, mobile: boolean, wrench: boolean, parent: string | null, pose: Matrix,
 *   axis: { direction: Vector, point: Vector }[], flange: Matrix, isArm: boolean, tools: { name: string, pose: Matrix }[], solids: Solid[] }} Device */
/** @typedef {{ name: string, parent: string, pose: Matrix, solids: Solid[] }} CellObject an object of the cell */
/** @typedef {{ frames: { name: string, parent: string, pose: Matrix }[], devices: Device[], objects: CellObject[] }} Geometry */
/** What is known of a device now: joints in rad, a mobile base as x, y, z (m) and a quaternion x, y, z, w, a force at the flange in N, an opening in m.
 * @typedef {{ joints: number[], commanded: number[], base: number[] | null, force: number[] | null, opening: number }} Live */

/** Longest chain of parents that is followed. */
const PARENTS_MAX = 64;
/** Free distance between devices that the cell does not place, m. */
const GAP = 0.35;

/** @param {unknown} value @param {number} count @param {number[]} [missing] @returns {number[]} */
function numbers(value, count, missing) {
  if (value === undefined && missing) return missing;
  if (!Array.isArray(value) || value.length !== count || !value.every(Number.isFinite))
    throw new Error("/geometry/: " + count + " numbers are expected, not " + JSON.stringify(value));
  return value;
}

/** @param {Json} json */
const posed = json => pose(numbers(json.position, 3, [0, 0, 0]), numbers(json.rotation, 4, [0, 0, 0, 1]));

/** @param {Json} json @returns {Solid} */
function solid(json) {
  const origin = [0, 0, 0];
  return {
    link: Number(json.link), role: String(json.role), kind: String(json.kind), pose: posed(json), radius: Number(json.radius ?? 0),
    from: numbers(json.from, 3, origin), to: numbers(json.to, 3, origin), size: numbers(json.size, 3, origin),
    slide: json.slide === undefined ? null : numbers(json.slide, 3),
    uri: String(json.uri ?? ""), file: String(json.file ?? ""), scale: numbers(json.scale, 3, [1, 1, 1]),
  };
}

/** Reads the resource. @param {Json} json @returns {Geometry} */
export function readGeometry(json) {
  if (json.version !== 1) throw new Error("/geometry/ has version " + json.version + "; this page reads 1\nhint: reload the page");
  const frames = (json.frame ?? []).map((/** @type {Json} */ it) => ({ name: String(it.name), parent: String(it.parent), pose: posed(it) }));
  const devices = (json.device ?? []).map((/** @type {Json} */ it) => ({
    name: String(it.name), type: String(it.type), serial: it.serial !== false, mobile: it.mobile === true, wrench: it.wrench === true,
    parent: it.parent === undefined ? null : String(it.parent), pose: posed(it),
    axis: (it.axis ?? []).map((/** @type {Json} */ axis) => ({ direction: numbers(axis.direction, 3), point: numbers(axis.point, 3) })),
    isArm: !!it.flange, flange: it.flange ? posed(it.flange[0]) : identity(),
    tools: (it.tool ?? []).map((/** @type {Json} */ tool) => ({ name: String(tool.name), pose: posed(tool) })),
    solids: (it.solid ?? []).map(solid),
  }));
  const objects = (json.object ?? []).map((/** @type {Json} */ it) =>
    ({ name: String(it.name), parent: String(it.parent), pose: posed(it), solids: (it.solid ?? []).map(solid) }));
  return { frames, devices, objects };
}

/** @returns {Live} */
export const atRest = () => ({ joints: [], commanded: [], base: null, force: null, opening: 0.05 });

/** How far the solids of a device reach from its base along the floor, m. @param {Device} device */
export function reach(device) {
  const points = device.solids.flatMap(it => it.kind === "box" ? [apply(it.pose, it.size.map(s => s / 2))] : [it.from, it.to]);
  const far = points.map(([x, y]) => Math.hypot(x, y));
  return Math.max(0.2, ...far);
}

/** Where devices stand that the cell does not place: in a row along y, beside all that it does.
 * @param {Geometry} geometry @returns {Map<string, Matrix>} */
export function rowOf(geometry) {
  const row = new Map();
  const isLoose = (/** @type {Device} */ device) => device.parent === null && device.solids.length > 0;
  const placed = geometry.devices.filter(device => device.parent !== null).map(device => device.pose[13] + 0.5);
  const loose = geometry.devices.filter(isLoose);
  const width = (/** @type {Device} */ device) => 2 * (device.isArm ? Math.max(0.3, reach(device)) : reach(device)) + GAP;
  const whole = loose.reduce((sum, device) => sum + width(device), 0);
  let at = placed.length ? Math.max(...placed) + GAP : -whole / 2;
  for (const device of loose) {
    row.set(device.name, pose([0, at + width(device) / 2, 0], [0, 0, 0, 1]));
    at += width(device);
  }
  return row;
}

/** Where everything is. It is computed once for each picture. */
export class Places {
  /** @param {Geometry} geometry @param {Map<string, Matrix>} row @param {Map<string, Live>} live
   * @param {"joints" | "commanded"} [which] measured or commanded joints */
  constructor(geometry, row, live, which = "joints") {
    this.geometry = geometry;
    this.row = row;
    this.live = live;
    this.which = which;
    /** @type {Map<string, Matrix | null>} */
    this.known = new Map([["world", identity()]]);
  }

  /** The pose of a frame in the world: `world`, a named frame, or `DEVICE.base`, `.odometry`, `.flange` or a tool; null if it is unknown.
   * @param {string} name @param {number} [depth] @returns {Matrix | null} */
  frame(name, depth = 0) {
    const known = this.known.get(name);
    if (known !== undefined) return known;
    const found = depth > PARENTS_MAX ? null : this.find(name, depth + 1);
    this.known.set(name, found);
    return found;
  }

  /** @param {string} name @param {number} depth @returns {Matrix | null} */
  find(name, depth) {
    const named = this.geometry.frames.find(frame => frame.name === name);
    if (named) return this.on(named.parent, named.pose, depth);
    const dot = name.lastIndexOf("."), part = name.slice(dot + 1);
    const device = this.geometry.devices.find(device => device.name === name.slice(0, dot));
    if (!device || dot < 0) return null;
    if (part === "odometry" || (part === "base" && !device.mobile)) return this.stand(device, depth);
    if (part === "base") return this.on(device.name + ".odometry", driven(this.live.get(device.name)?.base), depth);
    if (part === "flange") return device.isArm ? this.on(device.name + ".base", forward(device, this.joints(device)), depth) : null;
    const tool = device.tools.find(tool => tool.name === part);
    return tool ? this.on(device.name + ".flange", tool.pose, depth) : null;
  }

  /** Where an object is; null if its parent is unknown. @param {CellObject} object */
  object(object) {
    return this.on(object.parent, object.pose, 0);
  }

  /** @param {string} parent @param {Matrix} pose @param {number} depth */
  on(parent, pose, depth) {
    const below = this.frame(parent, depth);
    return below && multiply(below, pose);
  }

  /** Where the cell places a device, or the view. @param {Device} device @param {number} depth */
  stand(device, depth) {
    return device.parent === null ? this.row.get(device.name) ?? null : this.on(device.parent, device.pose, depth);
  }

  /** Joint positions; those that are not commanded are where they are. @param {Device} device @returns {number[]} */
  joints(device) {
    const live = this.live.get(device.name) ?? atRest();
    if (this.which === "joints") return live.joints;
    return device.axis.map((_, number) => Number.isFinite(live.commanded[number]) ? live.commanded[number] : live.joints[number]);
  }

  /** The poses of the links of a device in the world; null if its place is unknown. @param {Device} device @returns {Matrix[] | null} */
  links(device) {
    const base = this.frame(device.name + ".base");
    return base && links(device, this.joints(device)).map(link => multiply(base, link));
  }

  /** The pose of what an arm works with: its first tool, else its flange. @param {Device} device */
  tip(device) {
    return this.frame(device.name + "." + (device.tools[0]?.name ?? "flange"));
  }
}

/** The pose of a mobile base from where it started; that start while it is unknown. @param {number[] | null | undefined} base */
function driven(base) {
  if (!base || !base.every(Number.isFinite) || Math.abs(Math.hypot(...base.slice(3)) - 1) > 1e-3) return identity();
  return pose(base.slice(0, 3), base.slice(3));
}

/** Whether the commanded joints are visibly elsewhere than the measured ones. @param {Live} live */
export function differs(live) {
  return live.commanded.some((commanded, number) => Math.abs(commanded - live.joints[number]) > 0.002);
}
