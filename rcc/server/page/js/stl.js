// Meshes of STL files, binary and ASCII, as triangles with flat normals. It requests nothing and draws nothing.

/** Most bytes of a file, and most triangles of one. */
export const BYTES_MAX = 16 << 20, TRIANGLES_MAX = 200000;
/** Bytes of the head of a binary file, and of a triangle in it. */
const HEAD = 84, TRIANGLE = 50;
/** Largest coordinate, m; beyond it a file is damaged, not large. */
const PLACE_MAX = 1e6;

/** Corners of triangles, three numbers each. @typedef {Float32Array} Corners */

/** Reads a file. Throws its fault, which names what is wrong and where.
 * @param {ArrayBuffer} bytes @returns {Corners} */
export function readStl(bytes) {
  if (bytes.byteLength > BYTES_MAX) throw new Error("it has " + bytes.byteLength + " bytes; at most " + BYTES_MAX + " are read");
  const count = bytes.byteLength >= HEAD ? new DataView(bytes).getUint32(80, true) : -1;
  // Heads of binary files may begin with `solid` too: their length decides.
  if (count >= 0 && bytes.byteLength === HEAD + count * TRIANGLE) return binary(bytes, count);
  const begin = new TextDecoder().decode(bytes.slice(0, 512)).trimStart();
  if (begin.startsWith("solid") && /\bfacet\b|\bendsolid\b/.test(begin)) return ascii(new TextDecoder().decode(bytes));
  if (count >= 0) throw new Error("it has " + bytes.byteLength + " bytes; " + count + " triangles in its head need " + (HEAD + count * TRIANGLE));
  throw new Error("it is no STL file");
}

/** @param {number} count */
function room(count) {
  if (count > TRIANGLES_MAX) throw new Error("it has " + count + " triangles; at most " + TRIANGLES_MAX + " are drawn");
  if (!count) throw new Error("it has no triangles");
  return new Float32Array(9 * count);
}

/** @param {ArrayBuffer} bytes @param {number} count */
function binary(bytes, count) {
  const corners = room(count), view = new DataView(bytes);
  for (let triangle = 0; triangle < count; triangle++) {
    for (let n = 0; n < 9; n++) {
      // Behind the normal of the triangle, which many programs leave at 0.
      const value = view.getFloat32(HEAD + triangle * TRIANGLE + 12 + 4 * n, true);
      if (!(Math.abs(value) <= PLACE_MAX)) throw new Error("a corner of triangle " + triangle + " is at " + value);
      corners[9 * triangle + n] = value;
    }
  }
  return corners;
}

/** @param {string} text */
function ascii(text) {
  const found = [...text.matchAll(/\bvertex\s+(\S+)\s+(\S+)\s+(\S+)/g)], count = found.length / 3;
  if (!Number.isInteger(count)) throw new Error("it has " + found.length + " corners, which are no whole triangles");
  const corners = room(count);
  if (!/\bendsolid\b/.test(text)) throw new Error("it is cut off: it has no endsolid");
  found.forEach(([line, ...words], corner) => words.forEach((word, axis) => {
    const value = Number(word);
    if (!(Math.abs(value) <= PLACE_MAX)) throw new Error("`" + line.trim().slice(0, 60) + "` is no corner");
    corners[3 * corner + axis] = value;
  }));
  return corners;
}

/** Corners of a mesh: 65,535 fit the indices of one, so that large ones are several. */
const CORNERS_MAX = 65535;

/** What a renderer draws of corners: scaled, with the normals of their triangles. A mirrored mesh has its corners turned around, so that its
 * outside stays outside. @param {Corners} corners @param {number[]} scale
 * @returns {{ positions: Float32Array, normals: Float32Array, indices: Uint16Array }[]} */
export function pieces(corners, scale) {
  const order = scale[0] * scale[1] * scale[2] < 0 ? [0, 2, 1] : [0, 1, 2];
  const meshes = [];
  for (let begin = 0; begin < corners.length; begin += 3 * CORNERS_MAX) {
    const length = Math.min(3 * CORNERS_MAX, corners.length - begin), positions = new Float32Array(length), normals = new Float32Array(length);
    for (let at = 0; at < length; at += 9) {
      order.forEach((from, to) => { for (let axis = 0; axis < 3; axis++) positions[at + 3 * to + axis] = corners[begin + at + 3 * from + axis] * scale[axis]; });
      const [ax, ay, az, bx, by, bz, cx, cy, cz] = positions.subarray(at, at + 9);
      const [ux, uy, uz, vx, vy, vz] = [bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az];
      const normal = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], size = Math.hypot(...normal) || 1;
      for (let n = 0; n < 9; n++) normals[at + n] = normal[n % 3] / size;
    }
    meshes.push({ positions, normals, indices: Uint16Array.from({ length: length / 3 }, (_, n) => n) });
  }
  return meshes;
}
