// Which probes the 3-D view shows, and what each of them says about its device. It asks for nothing itself.

/** @typedef {import("./geometry.js").Geometry} Geometry */
/** @typedef {import("./geometry.js").Live} Live */
/** @typedef {import("./dom.js").Json} Json */
/** @typedef {import("./scope.js").Query} Query */

/** Probes of a device: joint positions, its place on the floor, its force, its opening. */
const JOINT = /^(.+)\.joint\.(\d+)\.(measured|set_point|commanded)$/;
const BASE = /^(.+)\.base\.pose\.(x|y|z|qx|qy|qz|qw)$/;
const POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"];
const FORCE = /^(.+)\.force\.(x|y|z)$/;
const OPENING = /^(.+)\.gripper\.(?:width|distance)$/;

/** The probes that show how the devices of the cell stand, by their period, with the divisor that gives about that rate.
 * @param {Json[]} probes as `/probes/` lists them @param {Geometry} geometry @param {number} rate_hz
 * @returns {Query[]} */
export function periods(probes, geometry, rate_hz) {
  const devices = new Set(geometry.devices.map(device => device.name));
  /** @type {Map<number, string[]>} */
  const byPeriod = new Map();
  const names = new Set(probes.map(probe => probe.name));
  for (const { name, period_s } of probes) {
    const found = [JOINT, BASE, FORCE, OPENING].map(kind => kind.exec(name)).find(Boolean);
    if (!found || !devices.has(found[1])) continue;
    // A set-point is what the last stage makes of a command; without one the command is shown.
    if (found[3] === "commanded" && names.has(name.replace(/commanded$/, "set_point"))) continue;
    const same = byPeriod.get(Number(period_s)) ?? [];
    byPeriod.set(Number(period_s), [...same, name]);
  }
  return [...byPeriod].map(([period_s, probes]) => ({ probes, every: divisor(period_s, rate_hz) }));
}

/** Of how many cycles one is sampled. @param {number} period_s @param {number} rate_hz */
export function divisor(period_s, rate_hz) {
  const every = Math.floor(1 / (rate_hz * period_s) + 1e-6);
  return Number.isFinite(every) ? Math.max(1, every) : 1;
}

/** What sets the value of a probe. @param {string} name @param {Map<string, Live>} live @returns {(value: number) => void} */
export function readProbe(name, live) {
  const joint = JOINT.exec(name);
  if (joint) {
    const device = live.get(joint[1]), number = Number(joint[2]), isMeasured = joint[3] === "measured";
    return value => { if (device) (isMeasured ? device.joints : device.commanded)[number] = value; };
  }
  const base = BASE.exec(name);
  if (base) return place(live.get(base[1]), "base", POSE.indexOf(base[2]));
  const force = FORCE.exec(name);
  if (force) return place(live.get(force[1]), "force", ["x", "y", "z"].indexOf(force[2]));
  const opening = OPENING.exec(name), device = opening && live.get(opening[1]);
  return value => { if (device && Number.isFinite(value)) device.opening = value; };
}

/** @param {Live | undefined} device @param {"base" | "force"} part @param {number} at @returns {(value: number) => void} */
function place(device, part, at) {
  return value => {
    if (!device) return;
    const values = device[part] ?? (part === "base" ? [0, 0, 0, 0, 0, 0, 1] : [0, 0, 0]);
    values[at] = value;
    device[part] = values;
  };
}
