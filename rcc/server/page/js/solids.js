// Triangles of simple solids, with normals. Several solids become one mesh, which is drawn at once.

import { add, apply, beside, direct, length, subtract, unit } from "./math3.js";

/** @typedef {import("./math3.js").Vector} Vector */
/** @typedef {import("./geometry.js").Solid} Solid */

/** Sides of what is round, and rings of a quarter of a sphere: fine ones, and those for browsers that draw in software. */
const FINE = { sides: 20, rings: 5 }, COARSE = { sides: 10, rings: 2 };

/** Triangles that grow solid by solid; at most 65,536 corners, as indices have 16 bits. */
export class Mesh {
  /** @param {boolean} isCoarse with fewer corners */
  constructor(isCoarse) {
    this.round = isCoarse ? COARSE : FINE;
    /** @type {number[]} */ this.positions = [];
    /** @type {number[]} */ this.normals = [];
    /** @type {number[]} */ this.indices = [];
  }

  get corners() { return this.positions.length / 3; }

  /** @param {Vector} position @param {Vector} normal */
  corner(position, normal) {
    this.positions.push(...position);
    this.normals.push(...normal);
    return this.corners - 1;
  }

  /** A ring of corners about a centre. @param {Vector} centre @param {Vector[]} sides two vectors across @param {number} radius
   * @param {Vector} up direction of the axis @param {number} slope of the normals along it, -1 to 1 @returns {number} its first corner */
  ring(centre, [x, y], radius, up, slope) {
    const flat = Math.sqrt(1 - slope * slope), first = this.corners, { sides } = this.round;
    for (let side = 0; side <= sides; side++) {
      const angle = 2 * Math.PI * side / sides, out = add(x.map(v => v * Math.cos(angle)), y, Math.sin(angle));
      this.corner(add(centre, out, radius), add(out.map(v => v * flat), up, slope));
    }
    return first;
  }

  /** The band between two rings, the second above the first. @param {number} below @param {number} above */
  band(below, above) {
    for (let side = 0; side < this.round.sides; side++) {
      const [a, b, c, d] = [below + side, below + side + 1, above + side, above + side + 1];
      this.indices.push(a, b, d, a, d, c);
    }
  }

  /** A disc. @param {Vector} centre @param {Vector[]} sides @param {number} radius @param {Vector} up where it faces */
  disc(centre, sides, radius, up) {
    const middle = this.corner(centre, up), rim = this.ring(centre, sides, radius, up, 1);
    for (let side = 0; side < this.round.sides; side++) this.indices.push(middle, rim + side, rim + side + 1);
  }

  /** A cone from a radius at one end to that at the other: a cylinder if they are equal.
   * @param {Vector} from @param {Vector} to @param {number} wide @param {number} [narrow] */
  cone(from, to, wide, narrow = wide) {
    const up = unit(subtract(to, from)), sides = beside(up), high = length(subtract(to, from));
    const slope = (wide - narrow) / Math.hypot(high, wide - narrow || 1e-12);
    this.band(this.ring(from, sides, wide, up, slope), this.ring(to, sides, narrow, up, slope));
    // Seen from below, a ring runs the other way around.
    this.disc(from, [sides[1], sides[0]], wide, up.map(v => -v));
    if (narrow > 0) this.disc(to, sides, narrow, up);
  }

  /** @param {Vector} from @param {Vector} to @param {number} radius */
  capsule(from, to, radius) {
    // One without length is a sphere.
    const up = length(subtract(to, from)) > 1e-9 ? unit(subtract(to, from)) : [0, 0, 1], sides = beside(up);
    /** @type {number | undefined} */
    let below;
    const { rings } = this.round;
    for (let ring = -rings; ring <= rings; ring++) {
      // The middle ring is there twice, at both ends.
      for (const end of ring < 0 ? [from] : ring > 0 ? [to] : [from, to]) {
        const slope = Math.sin(Math.PI / 2 * ring / rings), flat = Math.sqrt(Math.max(0, 1 - slope * slope));
        const above = this.ring(add(end, up, radius * slope), sides, radius * flat, up, slope);
        if (below !== undefined) this.band(below, above);
        below = above;
      }
    }
  }

  /** @param {import("./math3.js").Matrix} pose of its middle @param {Vector} size */
  box(pose, size) {
    for (const axis of [0, 1, 2]) {
      for (const side of [-1, 1]) {
        const [u, v] = [(axis + 1) % 3, (axis + 2) % 3], first = this.corners;
        const normal = [0, 0, 0];
        normal[axis] = side;
        for (const [su, sv] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
          const at = [0, 0, 0];
          at[axis] = side * size[axis] / 2;
          at[u] = su * size[u] / 2;
          at[v] = sv * size[v] / 2;
          this.corner(apply(pose, at), direct(pose, normal));
        }
        const [a, b, c, d] = side > 0 ? [0, 1, 2, 3] : [3, 2, 1, 0];
        this.indices.push(first + a, first + b, first + c, first + a, first + c, first + d);
      }
    }
  }

  /** @param {Solid} solid */
  solid(solid) {
    if (solid.kind === "capsule") this.capsule(solid.from, solid.to, solid.radius);
    else if (solid.kind === "cylinder") this.cone(solid.from, solid.to, solid.radius);
    else if (solid.kind === "box") this.box(solid.pose, solid.size);
  }
}

/** An arrow of length 1 along z. @param {boolean} isCoarse */
export function arrow(isCoarse) {
  const mesh = new Mesh(isCoarse);
  mesh.cone([0, 0, 0], [0, 0, 0.78], 0.035);
  mesh.cone([0, 0, 0.78], [0, 0, 1], 0.09, 0);
  return mesh;
}

/** Lines of a floor grid around the origin, m: thin ones, and one each metre. @param {number} half its half width, whole metres */
export function grid(half) {
  /** @type {{ thin: number[], metre: number[] }} */
  const lines = { thin: [], metre: [] };
  for (let step = -half * 4; step <= half * 4; step++) {
    const at = step / 4, into = step % 4 ? lines.thin : lines.metre;
    into.push(at, -half, 0, at, half, 0, -half, at, 0, half, at, 0);
  }
  return lines;
}
