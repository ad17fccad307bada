// Samples of the last time, in rings of numbers, and what of them a picture needs: per column of pixels the first, smallest, largest
// and last value. It draws nothing.

/** @typedef {import("./scope.js").Samples} Samples */

/** Numbers that all rings of a view may hold together: 128 MB. */
export const NUMBERS_MAX = 16e6;
/** Losses that a ring remembers. */
const LOSSES_MAX = 500;

/** The samples of a group of probes: rows of a time and a value for each, the oldest row is overwritten. */
export class Ring {
  /** @param {number} columns probes of the group @param {number} capacity rows */
  constructor(columns, capacity) {
    this.columns = columns;
    this.capacity = Math.max(2, Math.floor(capacity));
    this.times = new Float64Array(this.capacity);
    /** @type {Float64Array[]} */
    this.values = Array.from({ length: columns }, () => new Float64Array(this.capacity));
    this.start = 0;
    this.length = 0;
    /** Where samples are missing: time of the first row behind them, and how many. @type {{ time: number, count: number }[]} */
    this.losses = [];
  }

  /** @param {number} row */
  index(row) {
    const index = this.start + row;
    return index < this.capacity ? index : index - this.capacity;
  }

  /** @param {number} row */
  time(row) { return this.times[this.index(row)]; }

  /** @param {number} column @param {number} row */
  value(column, row) { return this.values[column][this.index(row)]; }

  get first() { return this.length ? this.time(0) : NaN; }
  get last() { return this.length ? this.time(this.length - 1) : NaN; }

  /** Adds the rows of a message. Rows that are not later than the last one begin a new record. @param {Samples} samples */
  push({ rows, columns, lost, data }) {
    if (!rows) return;
    if (data[0] <= this.last) this.clear();
    if (lost) this.place(rows, columns, lost, data);
    for (let row = Math.max(0, rows - this.capacity); row < rows; row++) {
      const from = row * (columns + 1), at = this.index(this.length % this.capacity);
      this.times[at] = data[from];
      for (let column = 0; column < this.columns; column++) this.values[column][at] = data[from + 1 + column];
      if (this.length < this.capacity) this.length++;
      else this.start = this.start + 1 === this.capacity ? 0 : this.start + 1;
    }
  }

  /** Lost samples are missing before the rows, in a capture also between them, where times leap.
   * @param {number} rows @param {number} columns @param {number} lost @param {Float64Array} data */
  place(rows, columns, lost, data) {
    const time = (/** @type {number} */ row) => data[row * (columns + 1)];
    let step = Infinity, isBetween = false;
    for (let row = 1; row < rows; row++) step = Math.min(step, time(row) - time(row - 1));
    for (let row = 1; row < rows; row++) {
      const missing = Math.round((time(row) - time(row - 1)) / step) - 1;
      if (missing > 0) this.lose(time(row), missing);
      isBetween ||= missing > 0;
    }
    if (!isBetween) this.lose(time(0), lost);
  }

  /** @param {number} time @param {number} count */
  lose(time, count) {
    if (this.losses.length === LOSSES_MAX) this.losses.shift();
    this.losses.push({ time, count });
  }

  clear() {
    this.start = this.length = 0;
    this.losses = [];
  }

  /** The first row at or after a time; as many as there are rows if there is none. @param {number} time */
  rowAt(time) {
    let low = 0, high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The value at the last sample up to a time; NaN before the first. @param {number} column @param {number} time */
  at(column, time) {
    const row = this.rowAt(time);
    if (row < this.length && this.time(row) === time) return this.value(column, row);
    return row ? this.value(column, row - 1) : NaN;
  }
}

/** For each column of pixels of a time range the first, smallest, largest and last value: four numbers, NaN where there is no sample,
 * and Infinity first where there are nulls alone.
 * @param {Ring} ring @param {number} column of the ring @param {number} from @param {number} to times @param {number} width pixels
 * @param {Float32Array} [out] @returns {Float32Array} */
export function decimate(ring, column, from, to, width, out = new Float32Array(4 * width)) {
  out.fill(NaN, 0, 4 * width);
  const first = ring.rowAt(from), end = ring.rowAt(to), start = ring.index(first), left = ring.capacity - start;
  // The rows lie in one piece, or in two: up to the end of the arrays, and from their beginning.
  const pieces = end - first <= left ? [[start, start + end - first]] : [[start, ring.capacity], [0, end - first - left]];
  const scale = width / (to - from), values = ring.values[column], { times } = ring;
  for (const [begin, over] of pieces) {
    for (let index = begin; index < over;) {
      const pixel = Math.min(width - 1, Math.max(0, Math.floor((times[index] - from) * scale)));
      const until = pixel === width - 1 ? Infinity : from + (pixel + 1) / scale;
      let low = Infinity, high = -Infinity, last = NaN, early = NaN;
      do {
        const value = values[index];
        if (value === value) {
          if (early !== early) early = value;
          if (value < low) low = value;
          if (value > high) high = value;
          last = value;
        }
      } while (++index < over && times[index] < until);
      keep(out, 4 * pixel, early, low, high, last);
    }
  }
  return out;
}

/** Adds samples to those of a column of pixels. A null ends the line, unless the column has a value.
 * @param {Float32Array} out @param {number} at @param {number} first @param {number} low @param {number} high @param {number} last */
function keep(out, at, first, low, high, last) {
  const isEmpty = out[at] !== out[at] || out[at] === Infinity;
  if (first !== first) {
    if (isEmpty) out[at] = Infinity;
    return;
  }
  out[at] = isEmpty ? first : out[at];
  out[at + 1] = isEmpty ? low : Math.min(out[at + 1], low);
  out[at + 2] = isEmpty ? high : Math.max(out[at + 2], high);
  out[at + 3] = last;
}

/** The smallest and the largest of decimated values; null without any. @param {Float32Array} points @param {number} width
 * @returns {[number, number] | null} */
export function range(points, width) {
  let low = Infinity, high = -Infinity;
  for (let pixel = 0; pixel < 4 * width; pixel += 4) {
    if (points[pixel + 1] < low) low = points[pixel + 1];
    if (points[pixel + 2] > high) high = points[pixel + 2];
  }
  return low <= high ? [low, high] : null;
}

/** Round numbers between two ends, at most so many. @param {number} low @param {number} high @param {number} most
 * @returns {{ step: number, ticks: number[] }} */
export function ticks(low, high, most) {
  const raw = (high - low) / Math.max(1, most);
  if (!(raw > 0) || !Number.isFinite(raw)) return { step: 1, ticks: [] };
  const power = 10 ** Math.floor(Math.log10(raw)), step = power * ([1, 2, 5, 10].find(factor => factor * power >= raw * 0.9999) ?? 10);
  const first = Math.ceil(low / step - 1e-9), count = Math.floor(high / step + 1e-9) - first + 1;
  return { step, ticks: Array.from({ length: Math.max(0, Math.min(100, count)) }, (_, number) => (first + number) * step) };
}

/** A number with as many digits as a step between ticks needs.
 * @param {number} value @param {number} step */
export function format(value, step) {
  if (!Number.isFinite(value)) return "—";
  if (value === 0) return "0";
  const size = Math.max(Math.abs(value), step);
  const power = (/** @type {number} */ of) => Math.floor(Math.log10(of) + 1e-9);
  if (size >= 1e6 || size < 1e-4) return value.toExponential(Math.min(12, Math.max(0, power(Math.abs(value)) - power(step)))).replace("e+", "e");
  return value.toFixed(Math.min(12, Math.max(0, Math.ceil(-Math.log10(step) - 1e-9))));
}

/** Columns of all rings as CSV: a row for each time, empty where a probe has no sample then.
 * @param {{ name: string, unit: string, ring: Ring, column: number }[]} series @param {number} from @param {number} to */
export function toCsv(series, from, to) {
  const quoted = (/** @type {string} */ text) => /[",\n]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
  const head = ["time [s]", ...series.map(it => quoted(it.unit ? `${it.name} [${it.unit}]` : it.name))];
  const rings = [...new Set(series.map(it => it.ring))];
  const rows = rings.map(ring => ring.rowAt(from)), ends = rings.map(ring => ring.rowAt(to + 1e-12));
  const lines = [head.join(",")];
  for (;;) {
    const due = rings.map((ring, number) => rows[number] < ends[number] ? ring.time(rows[number]) : Infinity), time = Math.min(...due);
    if (time === Infinity) return lines.join("\n") + "\n";
    const values = series.map(({ ring, column }) => {
      const number = rings.indexOf(ring);
      return due[number] === time ? number_text(ring.value(column, rows[number])) : "";
    });
    lines.push([String(time), ...values].join(","));
    due.forEach((at, number) => { if (at === time) rows[number]++; });
  }
}

/** Null is an empty field. @param {number} value */
const number_text = value => value !== value ? "" : String(value);
