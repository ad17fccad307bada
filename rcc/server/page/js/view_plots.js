// Plots of chosen probes over time, like an oscilloscope: rolling or triggered, with cursors and export.

import { list, make, section } from "./dom.js";
import { PRESETS, causes, picker, shorten } from "./probe_picker.js";
import { Plot, colour, themeOf } from "./plot.js";
import { connectPlot } from "./plot_input.js";
import { NUMBERS_MAX, Ring, format, toCsv } from "./samples.js";
import { Scopes } from "./scopes.js";
import { DEFAULTS, settingsOf, triggerForm } from "./trigger.js";

/** @typedef {import("./api.js").App} App */
/** @typedef {import("./plot.js").Series} Series */
/** @typedef {import("./probe_picker.js").Probe} Probe */

/** Messages per second, and pictures per second at most. */
const RATE_HZ = 30, PICTURES_HZ = 30;
/** Interval at which the list of probes is read, and values behind names are written, ms. */
const PROBES_MS = 5000, VALUES_MS = 200;
/** Time that is kept, of the time that is shown; at most so many seconds. */
const KEPT = 3, KEPT_MAX_S = 180;
const WINDOWS_S = [0.1, 0.5, 1, 2, 5, 10, 30, 60];
/** Most plots, and lines of one. */
export const PLOTS_MAX = 64, LINES_MAX = 16;

/** What stays while other views are open. */
const kept = {
  /** Names of the probes of each plot. @type {string[][]} */
  plots: [],
  window_s: 10,
  trigger: { ...DEFAULTS },
  /** @type {import("./trigger.js").Settings} */
  settings: settingsOf(DEFAULTS),
};

class Mounted {
  /** @param {HTMLElement} element @param {App} app */
  constructor(element, app) {
    this.app = app;
    /** @type {{ plot: Plot, card: HTMLElement, legend: HTMLElement }[]} */
    this.cards = [];
    /** @type {Probe[]} */ this.probes = [];
    /** @type {Ring[]} */ this.rings = [];
    /** @type {import("./plot.js").Axis} */
    this.axis = { from: -kept.window_s, to: 0, cursors: [null, null], trigger: null };
    /** While paused, samples are not kept and the axis stands. */
    this.isPaused = false;
    this.hasChanged = true;
    this.isOver = false;
    this.drawn_ms = 0;
    this.cost_ms = 0;
    this.pictures = 0;
    this.lost = 0;
    this.state = make("span", "choose probes", "dim");
    this.note = make("p", "", "bad plot-note");
    this.readout = make("p", "", "value plot-cursors");
    this.board = make("div", undefined, "plots");
    this.theme = themeOf();
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.dark.onchange = () => { this.theme = themeOf(); this.cards.forEach(card => this.legend(card)); this.changed(); };
    this.form = triggerForm(kept.trigger, settings => { kept.settings = settings; this.fail(""); this.ask(); }, text => this.fail(text));
    this.picker = picker(names => this.add(names), preset => this.preset(preset));
    const keys = "Drag or arrow keys: move in time. Wheel or + −: zoom; with Shift: values. Double click or 0: all. Space: pause. a, b: cursors; [ ] move them. Esc: no cursors.";
    element.append(section("Plots", "plot-tools", this.picker.element, this.toolbar(), this.form.form, this.readout, this.note, make("p", keys, "dim space-note")), this.board);
    this.observer = new IntersectionObserver(entries => {
      for (const entry of entries) {
        const card = this.cards.find(({ plot }) => plot.canvas === entry.target);
        if (card) card.plot.isVisible = entry.isIntersecting;
      }
      this.changed();
    });
    this.resized = new ResizeObserver(() => this.changed());
    this.scope = new Scopes({
      groups: (groups, rejected) => this.begin(groups, rejected),
      samples: samples => this.receive(samples),
      triggered: (time, cause) => { this.axis.trigger = time; this.showState("triggered: " + cause, true); },
      ended: (probe, cause) => this.end_of(probe, cause),
      // A capture counts its own losses.
      lost: (group, samples) => { if (kept.settings.trigger) return; this.lost += samples; this.rings[group]?.lose(this.rings[group].last, samples); },
      state: (text, isGood) => this.showState(text, isGood),
    });
    kept.plots.forEach(names => this.addPlot(names));
    this.ask();
    const picture = (/** @type {number} */ now) => {
      if (this.isOver) return;
      requestAnimationFrame(picture);
      // Pictures that take long come less often, so that the page stays usable.
      if (this.hasChanged && now - this.drawn_ms >= Math.max(1000 / PICTURES_HZ - 4, 2 * this.cost_ms)) this.draw(now);
    };
    requestAnimationFrame(picture);
    app.every(PROBES_MS, () => this.readProbes());
    app.every(VALUES_MS, () => this.showValues());
  }

  changed() { this.hasChanged = true; }

  /** @param {string} text */
  fail(text) { this.note.textContent = text; }

  /** @param {string} text @param {boolean} isGood */
  showState(text, isGood) {
    this.state.textContent = text;
    this.state.className = isGood ? "good" : "warn";
  }

  toolbar() {
    const bar = make("div", undefined, "row");
    const select = /** @type {HTMLSelectElement} */ (make("select"));
    select.append(...WINDOWS_S.map(time => new Option(time + " s", String(time))));
    select.value = String(kept.window_s);
    select.setAttribute("aria-label", "shown time");
    select.onchange = () => { kept.window_s = Number(select.value); this.all(); this.ask(); };
    bar.append(select);
    const button = (/** @type {string} */ text, /** @type {() => void} */ press) => {
      const element = make("button", text);
      element.onclick = press;
      bar.append(element);
      return element;
    };
    this.pauseButton = button("Pause", () => this.pause(!this.isPaused));
    button("Show all", () => this.all());
    button("CSV", () => this.save("plots.csv", new Blob([toCsv(this.series(), this.axis.from, this.axis.to)], { type: "text/csv" })));
    button("PNG", () => this.picture());
    button("Remove all", () => { [...this.cards].forEach(card => this.remove(card)); this.ask(); });
    bar.append(this.state);
    return bar;
  }

  /** @param {boolean} isPaused */
  pause(isPaused) {
    this.isPaused = isPaused;
    if (this.pauseButton) this.pauseButton.textContent = isPaused ? "Continue" : "Pause";
    if (!isPaused) this.follow();
    this.changed();
  }

  /** Shows what comes, in full. */
  all() {
    this.cards.forEach(({ plot }) => { plot.zoomed = null; });
    this.pause(false);
    this.follow();
  }

  async readProbes() {
    const known = this.probes.length;
    this.probes = /** @type {Probe[]} */ (list(await this.app.get("/probes/"), "probe"));
    this.picker.offer(this.probes);
    // Probes whose net or device has come since then are asked for again.
    if (this.probes.length !== known && this.missing().some(name => this.probes.some(probe => probe.name === name))) this.ask();
  }

  missing() { return this.cards.flatMap(({ plot }) => plot.series.filter(it => !it.ring).map(it => it.name)); }

  /** @param {string[]} names a plot for all of them */
  add(names) {
    this.addPlot(names);
    this.ask();
  }

  /** @param {string} id */
  preset(id) {
    const plots = PRESETS.find(preset => preset.id === id)?.plots(this.probes) ?? [];
    plots.forEach(names => this.addPlot(names));
    this.fail(plots.length ? "" : "The controller has no such probes.\nhint: they exist while their devices and nets do");
    this.ask();
  }

  /** @param {string[]} names */
  addPlot(names) {
    if (this.cards.length >= PLOTS_MAX) return this.fail(`${PLOTS_MAX} plots are the most\nhint: remove others`);
    if (names.length > LINES_MAX) this.fail(`${names.length} probes do not fit into one plot: the first ${LINES_MAX} are shown`);
    const series = names.slice(0, LINES_MAX).map(name => ({ name, unit: this.probes.find(probe => probe.name === name)?.unit ?? "", ring: null, column: 0 }));
    const plot = new Plot(series), card = make("section", undefined, "plot-card"), legend = make("div", undefined, "legend");
    const head = make("div", undefined, "row"), close = make("button", "×");
    close.title = "Remove this plot";
    close.setAttribute("aria-label", "Remove this plot");
    head.append(legend, close);
    card.append(head, plot.canvas);
    const entry = { plot, card, legend };
    close.onclick = () => { this.remove(entry); this.ask(); };
    plot.canvas.setAttribute("aria-label", "Plot of " + names.join(", "));
    connectPlot(plot, this);
    this.board.append(card);
    this.cards.push(entry);
    this.observer.observe(plot.canvas);
    this.resized.observe(plot.canvas);
    this.legend(entry);
  }

  /** @param {{ plot: Plot, card: HTMLElement }} entry */
  remove(entry) {
    entry.card.remove();
    this.observer.unobserve(entry.plot.canvas);
    this.cards = this.cards.filter(it => it.card !== entry.card);
  }

  /** Names with their colours; a click hides a line. @param {{ plot: Plot, legend: HTMLElement }} entry */
  legend({ plot, legend }) {
    const { common, rest } = shorten(plot.series.map(series => series.name));
    legend.replaceChildren(...(common ? [make("b", common)] : []), ...plot.series.map((series, number) => {
      const item = make("button", undefined, "line-name" + (series.isHidden ? " hidden-line" : "") + (series.ended ? " ended" : ""));
      const dot = make("i"), value = make("span", "", "value");
      dot.style.background = colour(number, this.theme.isDark);
      item.append(dot, rest[number] + (series.ended ? " (ended)" : ""), value);
      item.title = series.name + ": " + (series.ended ?? "hide or show this line");
      item.setAttribute("aria-pressed", String(!series.isHidden));
      item.onclick = () => { series.isHidden = !series.isHidden; this.legend({ plot, legend }); this.changed(); };
      return item;
    }));
  }

  /** Asks for what is plotted now. */
  ask() {
    kept.plots = this.cards.map(({ plot }) => plot.series.map(series => series.name));
    const names = [...new Set(kept.plots.flat())];
    this.form.offer(names);
    const { trigger, pre_s, post_s, mode } = kept.settings;
    this.axis.trigger = null;
    this.lost = 0;
    this.scope.ask(trigger ? { probes: names, trigger, pre_s, post_s, mode, rate_hz: RATE_HZ } : { probes: names, every: 1, rate_hz: RATE_HZ });
    if (!names.length) this.showState("choose probes", false);
    else if (trigger) this.showState("armed", true);
    this.board.dataset.empty = String(!this.cards.length);
    this.changed();
  }

  /** @param {import("./scope.js").Group[]} groups @param {import("./scope.js").Rejected[]} rejected */
  begin(groups, rejected) {
    const numbers = groups.reduce((sum, group) => sum + group.probes.length + 1, 0);
    const { trigger, pre_s, post_s } = kept.settings;
    const time_s = trigger ? pre_s + post_s + 1 : Math.min(KEPT_MAX_S, KEPT * kept.window_s + 2);
    // A group that is asked for again keeps its samples.
    const before = this.rings, names = this.groupNames;
    this.groupNames = groups.map(group => group.probes.map(probe => probe.name).join());
    this.rings = groups.map((group, number) => {
      const rows = Math.min(NUMBERS_MAX / Math.max(1, numbers), time_s / Math.max(1e-5, group.period_s) + 10);
      const same = names.indexOf(this.groupNames[number]);
      return same >= 0 && before[same].capacity === Math.floor(rows) ? before[same] : new Ring(group.probes.length, rows);
    });
    for (const { plot } of this.cards) {
      for (const series of plot.series) {
        const group = groups.findIndex(group => group.probes.some(probe => probe.name === series.name));
        series.ring = this.rings[group] ?? null;
        series.ended = rejected.find(it => it.probe === series.name)?.cause;
        if (group < 0) continue;
        series.column = groups[group].probes.findIndex(probe => probe.name === series.name);
        series.unit = groups[group].probes[series.column].unit;
      }
    }
    this.fail(causes(rejected));
    this.cards.forEach(card => this.legend(card));
    if (kept.settings.trigger && groups.length) this.showState("armed", true);
    this.changed();
  }

  /** Probes of each group of the last answer. @type {string[]} */
  groupNames = [];

  /** @param {import("./scope.js").Samples} samples */
  receive(samples) {
    const ring = this.rings[samples.group];
    if (!ring || this.isPaused) return;
    // A message is a whole capture, or continues the ones before.
    if (kept.settings.trigger) ring.clear();
    ring.push(samples);
    this.lost += samples.lost;
    this.follow();
    this.changed();
  }

  /** @param {string} probe @param {string} cause */
  end_of(probe, cause) {
    for (const card of this.cards) {
      for (const series of card.plot.series) if (series.name === probe) series.ended = cause;
      this.legend(card);
    }
  }

  /** Moves the axis to the latest samples. */
  follow() {
    const last = Math.max(...this.rings.map(ring => ring.last).filter(Number.isFinite), -Infinity);
    if (last === -Infinity) return;
    const { trigger, pre_s, post_s } = kept.settings;
    const [from, to] = trigger ? [last - pre_s - post_s, last] : [last - kept.window_s, last];
    Object.assign(this.axis, { from, to });
    this.changed();
  }

  /** @param {number} now */
  draw(now) {
    const begin = performance.now();
    this.hasChanged = false;
    for (const { plot } of this.cards) if (plot.isVisible) plot.draw(this.axis, this.theme);
    this.drawn_ms = now;
    this.cost_ms = 0.8 * this.cost_ms + 0.2 * (performance.now() - begin);
    this.board.dataset.pictures = String(++this.pictures);
  }

  /** Values behind the names: at cursor B, at cursor A, or the latest. */
  showValues() {
    const [a, b] = this.axis.cursors, at = b ?? a ?? this.axis.to;
    for (const { plot, legend } of this.cards) {
      if (!plot.isVisible) continue;
      const step = Math.max(1e-12, (plot.shown[1] - plot.shown[0]) / 1000);
      plot.series.forEach((series, number) => {
        const text = legend.querySelectorAll(".value")[number], ring = series.ring;
        if (!text) return;
        const difference = ring && a !== null && b !== null ? "  Δ " + format(ring.at(series.column, b) - ring.at(series.column, a), step) : "";
        text.textContent = ring ? format(ring.at(series.column, at), step) + difference : "—";
      });
    }
    const parts = [a === null ? "" : `A ${a.toFixed(6)} s`, b === null ? "" : `B ${b.toFixed(6)} s`];
    if (a !== null && b !== null && a !== b) parts.push(`Δt ${(b - a).toFixed(6)} s`, `1/Δt ${Math.abs(1 / (b - a)).toPrecision(6)} Hz`);
    if (this.lost) parts.push(`${this.lost} samples lost (red)`);
    this.readout.textContent = parts.filter(Boolean).join("   ");
  }

  /** @returns {{ name: string, unit: string, ring: Ring, column: number }[]} */
  series() {
    const all = this.cards.flatMap(({ plot }) => plot.series);
    const once = all.filter((series, number) => all.findIndex(it => it.name === series.name) === number);
    return once.flatMap(({ name, unit, ring, column }) => ring ? [{ name, unit, ring, column }] : []);
  }

  /** @param {string} name @param {Blob} blob */
  save(name, blob) {
    const link = /** @type {HTMLAnchorElement} */ (make("a"));
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  /** All plots as one picture, with the names of their lines. */
  picture() {
    const canvas = /** @type {HTMLCanvasElement} */ (make("canvas")), context = canvas.getContext("2d"), head = 20;
    if (!context || !this.cards.length) return this.fail("There is nothing to save.");
    canvas.width = Math.max(...this.cards.map(({ plot }) => plot.canvas.clientWidth));
    canvas.height = this.cards.reduce((sum, { plot }) => sum + plot.canvas.clientHeight + head, 0);
    context.fillStyle = this.theme.card;
    context.fillRect(0, 0, canvas.width, canvas.height);
    let y = 0;
    for (const { plot } of this.cards) {
      let x = 10;
      context.font = '12px system-ui, "DejaVu Sans", sans-serif';
      plot.series.forEach((series, number) => {
        context.fillStyle = colour(number, this.theme.isDark);
        context.fillText(series.name, x, y + 14);
        x += context.measureText(series.name).width + 16;
      });
      context.save();
      context.translate(0, y + head);
      plot.paint(context, this.axis, this.theme);
      context.restore();
      y += plot.canvas.clientHeight + head;
    }
    canvas.toBlob(blob => { if (blob) this.save("plots.png", blob); });
  }

  end() {
    this.isOver = true;
    this.dark.onchange = null;
    this.observer.disconnect();
    this.resized.disconnect();
    this.scope.close();
  }
}

/** @type {Mounted | null} */
let mounted = null;

/** @type {import("./api.js").View} */
export const view = {
  id: "plots",
  title: "Plots",
  mount: (element, app) => { mounted = new Mounted(element, app); },
  unmount: () => { mounted?.end(); mounted = null; },
};
