// Buses: EtherCAT segments with their topology and port counters; figures of the drivers of other buses, FRI and CAN.

import { ago, figure, figures, list, make, section, state, swap, table } from "./dom.js";
import { configured, pathOf } from "./view_overview.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

const NS = "http://www.w3.org/2000/svg";
/** Size of a slave in the picture, and the space between two, pixels. */
const WIDTH = 150, HEIGHT = 46, GAP_X = 26, GAP_Y = 14;
/** Entries of the history that are shown. */
const HISTORY_MAX = 20;
/** @param {number[]} counts */
const sum = counts => counts.reduce((a, b) => a + b, 0);

/** @param {string} tag @param {Record<string, string | number>} attributes @param {string} [text] */
function shape(tag, attributes, text) {
  const element = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Where slaves stand: in lines from the left, a branch begins a new line below. @param {Json[]} slaves */
function placed(slaves) {
  /** @type {Map<number, { x: number, y: number }>} */
  const places = new Map();
  const taken = new Set();
  let lines = 0;
  for (const slave of slaves) {
    const parent = slave.parent && places.get(slave.parent.position);
    let place = parent ? { x: parent.x + 1, y: parent.y } : { x: 0, y: lines };
    if (taken.has(place.x + " " + place.y)) place = { x: place.x, y: lines };
    places.set(slave.position, place);
    taken.add(place.x + " " + place.y);
    lines = Math.max(lines, place.y + 1);
  }
  return { places, lines, columns: Math.max(1, ...[...places.values()].map(place => place.x + 1)) };
}

/** The topology: boxes are slaves, lines their cables; what counts errors is marked. @param {Json} segment */
function topology(segment) {
  const slaves = list(segment, "slaves").filter(slave => slave.position !== null), { places, lines, columns } = placed(slaves);
  const [width, height] = [columns * (WIDTH + GAP_X) + 10, lines * (HEIGHT + GAP_Y) + 6];
  const svg = shape("svg", { width, height, viewBox: "0 0 " + width + " " + height, class: "topology", role: "img", "aria-label": "Topology of " + segment.segment });
  /** @param {{ x: number, y: number }} place @returns {[number, number]} */
  const at = place => [2 + place.x * (WIDTH + GAP_X), 3 + place.y * (HEIGHT + GAP_Y)];
  for (const slave of slaves) {
    const place = /** @type {{ x: number, y: number }} */ (places.get(slave.position)), [x, y] = at(place);
    const parent = slave.parent && places.get(slave.parent.position);
    const errors = sum(slave.invalid) + sum(slave.receive), lost = sum(slave.lost_links);
    if (parent) {
      const [px, py] = at(parent), from = px + WIDTH, middle = from + GAP_X / 2;
      const path = py === y ? `M${from} ${y + HEIGHT / 2}H${x}` : `M${from} ${py + HEIGHT / 2}H${middle}V${y + HEIGHT / 2}H${x}`;
      svg.append(shape("path", { d: path, class: "cable" + (slave.invalid[0] + slave.receive[0] + slave.lost_links[0] ? " warn" : "") }));
    }
    const group = shape("g", { class: slave.running ? errors + lost ? "slave warn" : "slave" : "slave bad" });
    const title = `${slave.spec}: ${slave.name}, ${slave.state}; ports: invalid ${slave.invalid}, receive errors ${slave.receive}, lost links ${slave.lost_links}`;
    group.append(shape("title", {}, title), shape("rect", { x, y, width: WIDTH, height: HEIGHT, rx: 4 }),
      shape("text", { x: x + 8, y: y + 18, class: "name" }, (slave.slave + " " + slave.spec).slice(0, 20)),
      shape("text", { x: x + 8, y: y + 35 }, slave.state + (errors + lost ? `  ${errors} errors, ${lost} lost` : "")));
    slave.ports.forEach((/** @type {Json} */ port, /** @type {number} */ number) => group.append(shape("circle",
      { cx: x + WIDTH - 40 + 10 * number, cy: y + HEIGHT - 9, r: 3, class: port.open ? "open" : port.link ? "link" : "closed" })));
    svg.append(group);
  }
  const box = make("div", undefined, "picture");
  box.append(svg);
  return box;
}

/** @param {Json} segment */
function segmentBox(segment) {
  const box = section("EtherCAT " + segment.segment + (segment.interfaces ? " at " + segment.interfaces.join(" and ") : ""));
  if (segment.error) { box.append(make("p", segment.error, "note bad")); return box; }
  const { frames } = segment, misses = sum(segment.groups.map((/** @type {Json} */ group) => group.misses));
  /** @param {number | null} seconds */
  const last = seconds => seconds === null ? "" : ", last " + ago(seconds) + " ago";
  box.append(figures(
    figure("state", segment.operational ? "operational" : segment.phase, segment.operational ? "good" : "bad"),
    figure("cycle", (segment.cycle_s * 1000).toPrecision(3) + " ms"), figure("cycles", segment.cycles),
    figure("frames lost" + (frames.lost ? last(frames.last_lost_ago_s) : ""), frames.lost + " of " + frames.sent, frames.lost ? "warn" : "good"),
    figure("late frames", frames.late), figure("working counters missed" + last(segment.last_miss_ago_s), misses, misses ? "warn" : "good"),
    ...segment.ring_open ? [figure("ring", segment.ring_open, "bad")] : []));
  const rows = segment.slaves.map((/** @type {Json} */ slave) => ({ cells: [slave.slave + "  " + slave.spec, slave.name,
    make("span", slave.state, "state " + (slave.running ? "good" : "bad")), { value: slave.invalid.join(" ") }, { value: slave.receive.join(" ") },
    { value: slave.lost_links.join(" ") }, { number: slave.difference_ns === null ? "—" : slave.difference_ns + " ns" }, slave.fault || slave.al_text || ""] }));
  const day = (/** @type {number} */ seconds) => new Date(seconds * 1000).toLocaleTimeString();
  const past = segment.history.entries.slice(-HISTORY_MAX).reverse().map((/** @type {Json} */ entry) =>
    ({ cells: [day(entry.begin), entry.end === null ? entry.lasts ? "lasts" : "" : day(entry.end), entry.text] }));
  const history = make("details");
  history.append(make("summary", "history"), table(["begin", "end", "event"], past, "nothing happened"));
  box.append(topology(segment),
    table(["slave", "name", "state", "invalid by port", "receive errors by port", "lost links by port", "clock difference", "fault"], rows, "no slaves"), history);
  return box;
}

/** Loads above which a CAN bus leaves too little for bursts, and starves low priorities: those of `takt can stat`. */
const LOAD_WARN = 0.6, LOAD_BAD = 0.9;

/** A load as a bar with its number; the mark is the most of any second. @param {Json} bus */
export function loadBar(bus) {
  const load = Number(bus.load), most = Number(bus.loadmax), box = make("div", undefined, "load");
  if (!Number.isFinite(load)) return make("span", "— (no bit rate)", "dim");
  const bar = make("div", undefined, "bar"), filled = make("i"), mark = make("b");
  filled.style.width = 100 * load + "%";
  mark.style.left = 100 * most + "%";
  bar.append(filled, mark);
  box.append(bar, make("span", (100 * load).toFixed(1) + " %", load >= LOAD_BAD ? "bad" : load >= LOAD_WARN ? "warn" : "good"));
  return box;
}

/** @param {Json[]} buses */
function busTable(buses) {
  const kilo = (/** @type {unknown} */ bits) => ({ number: (Number(bits) / 1000).toFixed(1) });
  return table(["bus", "bit rate, kbit/s", "load", "max %", "frames, kbit/s", "max, kbit/s"], buses.map(bus => ({ cells: [bus.name,
    bus.bitrate === undefined ? "—" : { number: (Number(bus.bitrate) / 1000).toFixed(0) }, loadBar(bus),
    { number: bus.loadmax === undefined ? "—" : (100 * Number(bus.loadmax)).toFixed(1) }, kilo(bus.bits), kilo(bus.bitsmax)] })), "");
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const drivers = section("Drivers"), can = section("CAN"), segments = make("div", undefined, "stack wide");
  [drivers.id, can.id, segments.id] = ["drivers", "can", "segments"];
  can.hidden = true;
  element.append(drivers, can, segments);
  app.every(1000, async () => {
    const devices = await app.get("/devices/"), buses = list(devices, "bus");
    can.hidden = !buses.length;
    if (buses.length) swap(can, make("h2", "CAN, over the last second"), busTable(buses));
    const all = await Promise.all(configured(devices).map(device => app.get(pathOf(device.name))));
    const rows = all.map(device => {
      const box = figures(...list(device, "figure").map(it => figure(it.name, it.value, it.name === "quality" && !/Perfect|Excellent/.test(it.value) ? "warn" : "")));
      return { cells: [device.name, device.type, state(device.state), box] };
    });
    swap(drivers, make("h2", "Drivers"), table(["device", "type", "state", "figures"], rows, "no devices"));
    const open = [...segments.querySelectorAll("details")].map(it => it.open);
    swap(segments, ...(await app.get("/ethercat/")).segments.map(segmentBox));
    segments.querySelectorAll("details").forEach((it, number) => { it.open = open[number] ?? false; });
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "buses", title: "Buses", mount, unmount() {} };
