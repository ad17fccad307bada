// One plot: lines over time on a canvas, with cursors. All plots of a view share their time axis, which is not here.

import { make } from "./dom.js";
import { decimate, format, range, ticks } from "./samples.js";

/** @typedef {import("./samples.js").Ring} Ring */
/** A line. @typedef {{ name: string, unit: string, ring: Ring | null, column: number, isHidden?: boolean, ended?: string }} Series */
/** What all plots share: the shown times, two cursors and the time of the trigger, s.
 * @typedef {{ from: number, to: number, cursors: (number | null)[], trigger: number | null }} Axis */
/** @typedef {{ ink: string, dim: string, line: string, card: string, bad: string, warn: string, accent: string, isDark: boolean }} Theme */

/** Room for the numbers, CSS pixels: left, right, above, below. */
export const ROOM = { left: 62, right: 10, top: 6, bottom: 18 };
const FONT = '11px system-ui, "DejaVu Sans", sans-serif';
const LIGHT = ["#1f6fc4", "#d1495b", "#2a8c4a", "#b36b00", "#7a4fc0", "#0d8a93", "#b0367f", "#5f6b76"];
const DARK = ["#6db3ff", "#ff8090", "#5fd08a", "#ffb84d", "#b99aff", "#4fd3dc", "#ff86c8", "#a7b3be"];

/** The colour of the line of that number. @param {number} number @param {boolean} isDark */
export const colour = (number, isDark) => (isDark ? DARK : LIGHT)[number % LIGHT.length];

/** The colours of the page. @returns {Theme} */
export function themeOf() {
  const style = getComputedStyle(document.documentElement);
  const names = /** @type {const} */ (["ink", "dim", "line", "card", "bad", "warn", "accent"]);
  const colours = Object.fromEntries(names.map(name => [name, style.getPropertyValue("--" + name).trim() || "gray"]));
  return /** @type {Theme} */ ({ ...colours, isDark: matchMedia("(prefers-color-scheme: dark)").matches });
}

export class Plot {
  /** @param {Series[]} series */
  constructor(series) {
    this.series = series;
    this.canvas = /** @type {HTMLCanvasElement} */ (make("canvas", undefined, "plot"));
    this.canvas.tabIndex = 0;
    this.context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    /** Chosen values at the lower and upper end; null fits to what is shown. @type {[number, number] | null} */
    this.zoomed = null;
    /** @type {[number, number]} */
    this.shown = [-1, 1];
    this.isVisible = true;
    /** @type {Float32Array[]} */
    this.points = [];
  }

  /** The width of the picture, CSS pixels. */
  get width() { return Math.max(1, this.canvas.clientWidth - ROOM.left - ROOM.right); }
  get height() { return Math.max(1, this.canvas.clientHeight - ROOM.top - ROOM.bottom); }

  /** The time at a place of the canvas. @param {Axis} axis @param {number} x CSS pixels */
  timeAt(axis, x) { return axis.from + (x - ROOM.left) / this.width * (axis.to - axis.from); }

  /** @param {Axis} axis @param {number} time */
  xOf(axis, time) { return ROOM.left + (time - axis.from) / (axis.to - axis.from) * this.width; }

  /** @param {number} y CSS pixels */
  valueAt(y) { return this.shown[1] - (y - ROOM.top) / this.height * (this.shown[1] - this.shown[0]); }

  /** Zooms the values around a place. @param {number} factor @param {number} y */
  zoom(factor, y) {
    const centre = this.valueAt(y), [low, high] = this.shown;
    this.zoomed = [centre + (low - centre) * factor, centre + (high - centre) * factor];
  }

  /** Moves the values. @param {number} dy CSS pixels, downwards */
  pan(dy) {
    const [low, high] = this.shown, by = dy / this.height * (high - low);
    this.zoomed = [low + by, high + by];
  }

  /** Draws the canvas as large as it is shown. @param {Axis} axis @param {Theme} theme */
  draw(axis, theme) {
    const { canvas, context } = this, scale = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    context.setTransform(scale, 0, 0, scale, 0, 0);
    this.paint(context, axis, theme);
  }

  /** @param {CanvasRenderingContext2D} g @param {Axis} axis @param {Theme} theme */
  paint(g, axis, theme) {
    const { width, height } = this, columns = Math.max(1, Math.floor(width));
    g.fillStyle = theme.card;
    g.fillRect(0, 0, width + ROOM.left + ROOM.right, height + ROOM.top + ROOM.bottom);
    const lines = this.series.map((series, number) => ({ series, number })).filter(({ series }) => series.ring && !series.isHidden);
    const ranges = lines.map(({ series, number }) => {
      const points = decimate(/** @type {Ring} */ (series.ring), series.column, axis.from, axis.to, columns, this.buffer(number, columns));
      return range(points, columns);
    });
    this.shown = this.zoomed ?? around(ranges);
    this.grid(g, axis, theme);
    g.save();
    g.beginPath();
    g.rect(ROOM.left, ROOM.top, width, height);
    g.clip();
    this.losses(g, axis, theme);
    for (const { number } of lines) this.line(g, this.points[number], columns, colour(number, theme.isDark));
    this.marks(g, axis, theme);
    g.restore();
  }

  /** @param {number} number @param {number} columns */
  buffer(number, columns) {
    const known = this.points[number];
    return known?.length === 4 * columns ? known : this.points[number] = new Float32Array(4 * columns);
  }

  /** @param {number} value */
  yOf(value) { return ROOM.top + (this.shown[1] - value) / (this.shown[1] - this.shown[0]) * this.height; }

  /** @param {CanvasRenderingContext2D} g @param {Axis} axis @param {Theme} theme */
  grid(g, axis, theme) {
    const { width, height } = this, [low, high] = this.shown;
    g.font = FONT;
    g.lineWidth = 1;
    g.strokeStyle = theme.line;
    g.fillStyle = theme.dim;
    g.textBaseline = "middle";
    g.textAlign = "right";
    const values = ticks(low, high, Math.max(2, height / 34));
    const times = ticks(axis.from, axis.to, Math.max(2, width / 90));
    g.beginPath();
    for (const value of values.ticks) {
      const y = Math.round(this.yOf(value)) + 0.5;
      g.moveTo(ROOM.left, y);
      g.lineTo(ROOM.left + width, y);
      g.fillText(format(value, values.step), ROOM.left - 6, Math.min(ROOM.top + height - 4, Math.max(ROOM.top + 5, y)));
    }
    g.textAlign = "center";
    for (const time of times.ticks) {
      const x = Math.round(this.xOf(axis, time)) + 0.5;
      g.moveTo(x, ROOM.top);
      g.lineTo(x, ROOM.top + height);
      const text = format(time, times.step) + " s", half = g.measureText(text).width / 2;
      g.fillText(text, Math.min(ROOM.left + width - half, Math.max(ROOM.left + half, x)), ROOM.top + height + 10);
    }
    g.stroke();
    const unit = this.series[0]?.unit;
    if (unit) {
      g.save();
      g.translate(9, ROOM.top + height / 2);
      g.rotate(-Math.PI / 2);
      g.fillText(unit, 0, 0);
      g.restore();
    }
  }

  /** Bars where samples are missing. @param {CanvasRenderingContext2D} g @param {Axis} axis @param {Theme} theme */
  losses(g, axis, theme) {
    g.fillStyle = theme.bad;
    for (const ring of new Set(this.series.map(series => series.ring))) {
      for (const { time } of ring?.losses ?? []) {
        if (!ring || time < axis.from || time > axis.to) continue;
        const row = ring.rowAt(time), from = this.xOf(axis, row ? ring.time(row - 1) : axis.from), wide = Math.max(2, this.xOf(axis, time) - from);
        g.globalAlpha = 0.3;
        g.fillRect(from, ROOM.top, wide, this.height);
        g.globalAlpha = 1;
        g.fillRect(from, ROOM.top, wide, 4);
      }
    }
  }

  /** @param {CanvasRenderingContext2D} g @param {Float32Array} points @param {number} columns @param {string} colour */
  line(g, points, columns, colour) {
    g.strokeStyle = colour;
    g.lineWidth = 1.25;
    g.lineJoin = "round";
    g.beginPath();
    const top = ROOM.top - 1e4, bottom = ROOM.top + this.height + 1e4;
    // Coordinates far outside slow down or break canvases.
    const y = (/** @type {number} */ value) => Math.min(bottom, Math.max(top, this.yOf(value)));
    let isFirst = true;
    for (let column = 0; column < columns; column++) {
      const at = 4 * column, first = points[at];
      if (first !== first) continue;
      if (first === Infinity) { isFirst = true; continue; }
      const x = ROOM.left + column + 0.5;
      if (isFirst) g.moveTo(x, y(first));
      else g.lineTo(x, y(first));
      isFirst = false;
      if (points[at + 1] !== points[at + 2]) {
        g.lineTo(x, y(points[at + 1]));
        g.lineTo(x, y(points[at + 2]));
        g.lineTo(x, y(points[at + 3]));
      }
    }
    g.stroke();
  }

  /** Trigger and cursors. @param {CanvasRenderingContext2D} g @param {Axis} axis @param {Theme} theme */
  marks(g, axis, theme) {
    /** @param {number} time @param {string} colour @param {number[]} dash @param {string} text */
    const mark = (time, colour, dash, text) => {
      const x = Math.round(this.xOf(axis, time)) + 0.5;
      g.strokeStyle = g.fillStyle = colour;
      g.lineWidth = 1;
      g.setLineDash(dash);
      g.beginPath();
      g.moveTo(x, ROOM.top);
      g.lineTo(x, ROOM.top + this.height);
      g.stroke();
      g.setLineDash([]);
      g.textAlign = "left";
      g.fillText(text, x + 3, ROOM.top + 8);
    };
    g.font = FONT;
    g.textBaseline = "middle";
    if (axis.trigger !== null) mark(axis.trigger, theme.warn, [2, 2], "T");
    axis.cursors.forEach((time, number) => { if (time !== null) mark(time, theme.ink, [5, 3], "AB"[number]); });
  }
}

/** Room for what is shown, a little more than its range. @param {([number, number] | null)[]} ranges @returns {[number, number]} */
export function around(ranges) {
  const known = ranges.flatMap(range => range ?? []).filter(Number.isFinite);
  if (!known.length) return [-1, 1];
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1e-6;
  return [low - room, high + room];
}
