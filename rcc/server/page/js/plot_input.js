// Mouse, touch and keyboard of plots: time and values move and zoom, two cursors are placed and moved.

/** @typedef {import("./plot.js").Plot} Plot */
/** What plots share. @typedef {{ axis: import("./plot.js").Axis, pause: (isPaused: boolean) => void, all: () => void, isPaused: boolean,
 *   changed: () => void, showValues: () => void }} Board */

/** Parts of the shown time that a key moves or zooms, and distance at which a cursor is caught, CSS pixels. */
const STEP = 0.1, CATCH = 6;
/** Shortest and longest shown time, s. */
const TIME_MIN = 1e-5, TIME_MAX = 600;

/** Zooms the time around a moment. @param {import("./plot.js").Axis} axis @param {number} factor @param {number} centre */
export function zoomTime(axis, factor, centre) {
  const wide = Math.min(TIME_MAX, Math.max(TIME_MIN, (axis.to - axis.from) * factor)), part = (centre - axis.from) / (axis.to - axis.from);
  axis.from = centre - part * wide;
  axis.to = axis.from + wide;
}

/** @param {import("./plot.js").Axis} axis @param {number} by s */
export function moveTime(axis, by) {
  axis.from += by;
  axis.to += by;
}

/** @param {Plot} plot @param {Board} board */
export function connectPlot(plot, board) {
  const { canvas } = plot, { axis } = board;
  let [x, y] = [NaN, NaN];
  /** What is dragged: the time, the values, or a cursor. @type {"time" | "values" | number | null} */
  let drag = null;
  const stop = () => { if (!board.isPaused) board.pause(true); };
  canvas.onpointerdown = event => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    [x, y] = [event.offsetX, event.offsetY];
    const caught = axis.cursors.findIndex(time => time !== null && Math.abs(plot.xOf(axis, time) - x) < CATCH);
    drag = caught >= 0 ? caught : event.shiftKey ? "values" : "time";
  };
  canvas.onpointerup = canvas.onpointercancel = () => { drag = null; };
  canvas.onpointermove = event => {
    const [dx, dy] = [event.offsetX - x, event.offsetY - y];
    [x, y] = [event.offsetX, event.offsetY];
    if (drag === null || (!dx && !dy)) return;
    if (typeof drag === "number") { stop(); axis.cursors[drag] = plot.timeAt(axis, x); }
    else if (drag === "values") plot.pan(dy);
    else { stop(); moveTime(axis, -dx / plot.width * (axis.to - axis.from)); }
    board.changed();
  };
  canvas.onpointerleave = () => { if (drag === null) [x, y] = [NaN, NaN]; };
  canvas.addEventListener("wheel", event => {
    // The page scrolls unless the plot was chosen.
    if (document.activeElement !== canvas && !event.ctrlKey && !event.shiftKey) return;
    event.preventDefault();
    const factor = Math.exp(Math.min(60, Math.max(-60, event.deltaY || event.deltaX)) * 0.004);
    if (event.shiftKey) plot.zoom(factor, event.offsetY);
    else { stop(); zoomTime(axis, factor, plot.timeAt(axis, event.offsetX)); }
    board.changed();
  }, { passive: false });
  canvas.ondblclick = () => board.all();
  canvas.onkeydown = event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const centre = Number.isFinite(x) ? plot.timeAt(axis, x) : (axis.from + axis.to) / 2;
    if (!key(event.key, event.shiftKey, plot, board, centre, stop)) return;
    event.preventDefault();
    board.showValues();
    board.changed();
  };
}

/** Whether the key was one of the plot's. @param {string} key @param {boolean} isShifted @param {Plot} plot @param {Board} board
 * @param {number} centre time under the mouse @param {() => void} stop pauses */
export function key(key, isShifted, plot, board, centre, stop) {
  const { axis } = board, wide = axis.to - axis.from, middle = plot.height / 2;
  switch (key) {
    case "ArrowLeft": stop(); moveTime(axis, -STEP * wide); break;
    case "ArrowRight": stop(); moveTime(axis, STEP * wide); break;
    case "ArrowUp": plot.pan(STEP * plot.height); break;
    case "ArrowDown": plot.pan(-STEP * plot.height); break;
    // Shift and + are one key on many keyboards: the letter of the values is v, upwards and downwards.
    case "+": case "=": stop(); zoomTime(axis, 1 / (1 + STEP), centre); break;
    case "-": stop(); zoomTime(axis, 1 + STEP, centre); break;
    case "v": plot.zoom(1 / (1 + STEP), middle); break;
    case "V": plot.zoom(1 + STEP, middle); break;
    case " ": board.pause(!board.isPaused); break;
    case "0": case "Home": board.all(); break;
    case "a": case "A": stop(); axis.cursors[0] = centre; break;
    case "b": case "B": stop(); axis.cursors[1] = centre; break;
    case "[": case "]": case "{": case "}": {
      const number = isShifted || axis.cursors[1] === null ? 0 : 1, time = axis.cursors[number];
      if (time === null) return false;
      axis.cursors[number] = time + (key === "[" || key === "{" ? -1 : 1) * wide / plot.width;
      break;
    }
    case "Escape": axis.cursors = [null, null]; break;
    default: return false;
  }
  return true;
}
