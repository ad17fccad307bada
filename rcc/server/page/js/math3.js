// Poses and projections of the 3-D view: matrices of four columns in one array, column by column, lengths in m, angles in rad.

/** @typedef {Float64Array} Matrix sixteen numbers, column by column */
/** @typedef {number[]} Vector three numbers */

/** @param {ArrayLike<number>} numbers @returns {Matrix} */
const matrix = numbers => Float64Array.from(numbers);

export const identity = () => matrix([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

/** The product of two matrices: the second is applied first. @param {Matrix} a @param {Matrix} b */
export function multiply(a, b) {
  const out = new Float64Array(16);
  for (let column = 0; column < 16; column += 4)
    for (let row = 0; row < 4; row++)
      out[column + row] = a[row] * b[column] + a[4 + row] * b[column + 1] + a[8 + row] * b[column + 2] + a[12 + row] * b[column + 3];
  return out;
}

/** A pose. @param {number[] | Float64Array} position @param {number[] | Float64Array} rotation quaternion x, y, z, w of length 1 */
export function pose([px, py, pz], [x, y, z, w]) {
  return matrix([
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1]);
}

/** @param {number[] | Float64Array} position */
export const shift = position => pose(position, [0, 0, 0, 1]);

/** The rotation by an angle about an axis through a point.
 * @param {Vector} direction unit vector along the axis @param {Vector} point on the axis @param {number} angle */
export function about([x, y, z], point, angle) {
  const half = Math.sin(angle / 2);
  const turned = pose([0, 0, 0], [x * half, y * half, z * half, Math.cos(angle / 2)]);
  const moved = direct(turned, point);
  for (let row = 0; row < 3; row++) turned[12 + row] = point[row] - moved[row];
  return turned;
}

/** A point, moved by a pose. @param {Matrix} m @param {number[] | Float64Array} p @returns {Vector} */
export function apply(m, [x, y, z]) {
  return [0, 1, 2].map(row => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row]);
}

/** A direction, turned by a pose. @param {Matrix} m @param {number[] | Float64Array} v @returns {Vector} */
export function direct(m, [x, y, z]) {
  return [0, 1, 2].map(row => m[row] * x + m[4 + row] * y + m[8 + row] * z);
}

/** @param {Vector} a @param {Vector} b */
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

/** @param {Vector} a @param {Vector} b @param {number} [factor] */
export const add = (a, b, factor = 1) => [a[0] + b[0] * factor, a[1] + b[1] * factor, a[2] + b[2] * factor];

/** @param {Vector} a @param {Vector} b */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @param {Vector} a */
export const length = a => Math.hypot(a[0], a[1], a[2]);

/** The vector of length 1; that along z for a vector without length. @param {Vector} a */
export function unit(a) {
  const long = length(a);
  return long > 1e-12 ? [a[0] / long, a[1] / long, a[2] / long] : [0, 0, 1];
}

/** Two unit vectors that make a right-handed system with a unit vector. @param {Vector} z */
export function beside(z) {
  const x = unit(cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z));
  return [x, cross(z, x)];
}

/** A camera's projection. @param {number} angle its vertical field of view @param {number} aspect width by height
 * @param {number} near @param {number} far */
export function perspective(angle, aspect, near, far) {
  const scale = 1 / Math.tan(angle / 2), depth = 1 / (near - far);
  return matrix([scale / aspect, 0, 0, 0, 0, scale, 0, 0, 0, 0, (near + far) * depth, -1, 0, 0, 2 * near * far * depth, 0]);
}

/** The world as a camera sees it, with z of the world upwards. @param {Vector} eye @param {Vector} target */
export function lookAt(eye, target) {
  const z = unit(subtract(eye, target)), x = unit(cross([0, 0, 1], z)), y = cross(z, x);
  return matrix([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);
}

/** Where a point is on the screen: x and y from -1 to 1, upwards; none behind the camera.
 * @param {Matrix} projected projection times view @param {Vector} p @returns {[number, number] | null} */
export function project(projected, p) {
  const w = projected[3] * p[0] + projected[7] * p[1] + projected[11] * p[2] + projected[15];
  if (!(w > 1e-6)) return null;
  const [x, y] = apply(projected, p);
  return [x / w, y / w];
}

/** How far the links of a device have moved from where they are while all joints are at 0, in its base: of the base, which has not,
 * and behind each joint. Joints that are not known are at 0.
 * @param {{ axis: { direction: Vector, point: Vector }[], serial: boolean }} device @param {ArrayLike<number>} joints rad */
export function links(device, joints) {
  const moved = [identity()];
  device.axis.forEach(({ direction, point }, number) => {
    const turn = about(direction, point, Number.isFinite(joints[number]) ? joints[number] : 0);
    moved.push(device.serial ? multiply(moved[number], turn) : turn);
  });
  return moved;
}

/** The flange in the base of an arm. @param {Parameters<typeof links>[0] & { flange: Matrix }} device @param {ArrayLike<number>} joints */
export function forward(device, joints) {
  return multiply(links(device, joints)[device.axis.length], device.flange);
}
