// A camera that circles around a point, moved by mouse, touch and keyboard.

import { add, cross, lookAt, multiply, perspective, project, subtract, unit } from "./math3.js";

/** @typedef {import("./math3.js").Vector} Vector */

/** Vertical field of view, rad. */
const ANGLE = 0.75;
/** The part of the picture that a fitted box fills. */
const MARGIN = 0.9;
/** Nearest and farthest distance from the target, m. */
const NEAR = 0.15, FAR = 200;
/** Turned by a key, rad; moved by a key or the wheel, of the distance. */
const KEY_TURN = 0.08, KEY_STEP = 0.06;

export class Camera {
  constructor() {
    /** @type {Vector} */ this.target = [0, 0, 0.5];
    this.distance = 4;
    /** Around z, and above the floor. */
    this.yaw = -0.55;
    this.pitch = 0.4;
  }

  /** @returns {Vector} */
  get eye() {
    const flat = this.distance * Math.cos(this.pitch);
    return add(this.target, [flat * Math.cos(this.yaw), flat * Math.sin(this.yaw), this.distance * Math.sin(this.pitch)]);
  }

  /** Projection times view. @param {number} aspect */
  matrix(aspect) {
    return multiply(perspective(ANGLE, aspect, this.distance / 50, this.distance * 12 + 20), lookAt(this.eye, this.target));
  }

  /** @param {number} yaw @param {number} pitch */
  orbit(yaw, pitch) {
    this.yaw = (this.yaw + yaw) % (2 * Math.PI);
    this.pitch = Math.min(1.55, Math.max(-1.2, this.pitch + pitch));
  }

  /** Moves the target across the picture, by parts of its height. @param {number} right @param {number} up */
  pan(right, up) {
    const back = unit(subtract(this.eye, this.target)), x = unit(cross([0, 0, 1], back)), y = cross(back, x);
    const height = 2 * this.distance * Math.tan(ANGLE / 2);
    this.target = add(add(this.target, x, right * height), y, up * height);
  }

  /** @param {number} factor of the distance */
  zoom(factor) {
    this.distance = Math.min(FAR, Math.max(NEAR, this.distance * factor));
  }

  /** Brings all corners of a box into the picture, as near as that is possible. @param {Vector} low @param {Vector} high
   * @param {number} aspect */
  fit(low, high, aspect) {
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(bits => low.map((value, axis) => bits >> axis & 1 ? high[axis] : value));
    this.target = low.map((value, axis) => (value + high[axis]) / 2);
    let [near, far] = [NEAR, FAR];
    for (let round = 0; round < 24; round++) {
      this.distance = Math.sqrt(near * far);
      const seen = corners.map(corner => project(this.matrix(aspect), corner));
      if (seen.every(at => at && Math.abs(at[0]) < MARGIN && Math.abs(at[1]) < MARGIN)) far = this.distance;
      else near = this.distance;
    }
    this.distance = far;
  }

  /** Whether the key was one of the camera's. @param {string} key @param {boolean} isShifted @param {() => void} fit */
  key(key, isShifted, fit) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[/** @type {keyof typeof arrows} */ (key)];
    if (arrow && isShifted) this.pan(arrow[0] * KEY_STEP, arrow[1] * KEY_STEP);
    else if (arrow) this.orbit(arrow[0] * KEY_TURN, arrow[1] * KEY_TURN);
    else if (key === "+" || key === "=") this.zoom(1 - KEY_STEP);
    else if (key === "-") this.zoom(1 / (1 - KEY_STEP));
    else if (key === "f" || key === "Home") fit();
    else return false;
    return true;
  }
}

/** Connects a camera with an element. Dragging turns; with Shift, the right or the middle button, or two fingers, it moves; the wheel
 * and pinching change the distance. @param {HTMLElement} element @param {Camera} camera @param {() => void} changed @param {() => void} fit */
export function connectCamera(element, camera, changed, fit) {
  /** @type {Map<number, PointerEvent>} */
  const pointers = new Map();
  element.onpointerdown = event => {
    pointers.set(event.pointerId, event);
    element.setPointerCapture(event.pointerId);
    element.focus();
  };
  element.onpointerup = element.onpointercancel = event => { pointers.delete(event.pointerId); };
  element.oncontextmenu = event => event.preventDefault();
  element.onpointermove = event => {
    const before = pointers.get(event.pointerId), height = element.clientHeight || 1;
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (/** @type {PointerEvent} */ it) => Math.hypot(it.clientX - other.clientX, it.clientY - other.clientY) || 1;
      camera.zoom(apart(before) / apart(event));
      camera.pan(-dx / 2 / height, dy / 2 / height);
    } else if (event.shiftKey || event.buttons & 6) camera.pan(-dx / height, dy / height);
    else camera.orbit(-dx * 0.008, dy * 0.008);
    pointers.set(event.pointerId, event);
    changed();
  };
  element.addEventListener("wheel", event => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.min(60, Math.max(-60, event.deltaY)) * 0.004));
    changed();
  }, { passive: false });
  element.onkeydown = event => {
    if (event.ctrlKey || event.altKey || event.metaKey || !camera.key(event.key, event.shiftKey, fit)) return;
    event.preventDefault();
    changed();
  };
}
