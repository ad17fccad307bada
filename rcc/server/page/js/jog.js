// Jogging of an arm, hold-to-run. The net that moves it brakes when its last velocity is older than 0.1 s, in the controller: what is
// here only sends velocities as long as a button is held, and nothing once something is late.

import { DirectIo, quoted } from "./directio.js";

/** Interval of the velocities, ms. */
const PERIOD_MS = 25;
/** A velocity that was not confirmed for so long, or a page that was late by so much, ends the hold, ms. */
export const STALL_MS = 100;
/** Limits of the flange, m/s and rad/s; the net scales them by its speed. */
const VELOCITY = 0.25, ROTATION = 0.5;

/** A direction as a set-point: `x+`, `rz-`, `j3+`. @param {string} direction @param {number[]} limits of the joints, rad/s */
export function setPoint(direction, limits) {
  const found = /^(r?)([xyz])([+-])$|^j(\d+)([+-])$/.exec(direction);
  if (!found) throw new Error("unknown direction " + direction);
  const [, turns, axis, sign, joint, jointSign] = found;
  if (joint !== undefined) {
    const velocities = limits.map((limit, number) => number === Number(joint) ? (jointSign === "+" ? limit : -limit) : 0);
    return "[" + velocities.join(",") + "]";
  }
  const zero = { x: 0, y: 0, z: 0 }, value = (turns ? ROTATION : VELOCITY) * (sign === "+" ? 1 : -1), own = { ...zero, [axis]: value };
  const text = (/** @type {{ x: number, y: number, z: number }} */ v) => `{x:${v.x},y:${v.y},z:${v.z}}`;
  return `{vel:${text(turns ? zero : own)},rot:${text(turns ? own : zero)}}`;
}

/** What rests. @param {"joints" | "flange"} kind @param {number} count of joints */
export const rest = (kind, count) => kind === "joints" ? "[" + Array(count).fill(0).join(",") + "]" : "{vel:{x:0,y:0,z:0},rot:{x:0,y:0,z:0}}";

/** An arm that is jogged through a connection of its own. */
export class Jog {
  /** @param {{ kind: "joints" | "flange", limits: number[], released: (why: string) => void, ended: (why: string) => void, now?: () => number }} options
   *  `released`: a hold ended without its button; `ended`: the connection is lost */
  constructor({ kind, limits, released, ended, now = () => performance.now() }) {
    this.kind = kind;
    this.limits = limits;
    this.released = released;
    this.now = now;
    this.link = new DirectIo();
    this.link.onEnd = why => { this.held = null; clearInterval(this.timer); ended(why); };
    this.net = "";
    /** The direction that is held. @type {string | null} */ this.held = null;
    /** When the velocity that is not confirmed yet was sent. @type {number | null} */ this.sentAt = null;
    this.lastTick = 0;
    /** @type {ReturnType<typeof setInterval> | undefined} */ this.timer = undefined;
  }

  /** Connects, loads the net and starts it: the arm is held by it then, at rest. @param {string} text @param {string} arm */
  async begin(text, arm) {
    await this.link.open();
    const [session] = await this.link.call("nse", quoted("page: jogs " + arm), quoted("end"));
    const [net] = await this.link.call("nene", quoted(text), quoted(session), quoted("jog of " + arm + " by the page"));
    this.net = net;
    await this.link.call("nest", quoted(net));
    this.timer = setInterval(() => this.tick(), PERIOD_MS);
  }

  /** A button is pressed. @param {string} direction */
  hold(direction) {
    this.held = direction;
    this.lastTick = this.now();
    this.tick();
  }

  /** A button is released, or something demands it. @param {string} [why] unless it was the button */
  release(why) {
    if (this.held === null) return;
    this.held = null;
    this.sentAt = null;
    this.send(rest(this.kind, this.limits.length));
    if (why) this.released(why);
  }

  tick() {
    const now = this.now(), late = now - this.lastTick;
    this.lastTick = now;
    if (this.held === null) return;
    if (late > STALL_MS) this.release("the page stalled for " + Math.round(late) + " ms");
    else if (this.sentAt === null) { this.sentAt = now; this.send(setPoint(this.held, this.limits)); }
    // No queue of velocities builds up that would move the arm later.
    else if (now - this.sentAt > STALL_MS) this.release("the connection stalled");
  }

  /** @param {string} value */
  send(value) {
    const confirmed = () => { this.sentAt = null; };
    this.link.call("snc", `{${this.net}:{insent:${quoted(value)}}}`).then(confirmed, error => {
      confirmed();
      if (this.held !== null) this.release(error.message);
    });
  }

  /** Ends the session, and with it the net: the arm brakes if it moves. */
  close() {
    clearInterval(this.timer);
    this.held = null;
    this.link.onEnd = () => {};
    this.link.end("closed");
  }
}
