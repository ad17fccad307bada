// Flight recordings: what was written around faults and on request, to be saved.

import { button, list, make, section, state, swap, table } from "./dom.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** Interval of the list, ms. */
const PERIOD_MS = 1000;

/** Bytes in a readable unit. @param {number} bytes */
export function size(bytes) {
  if (bytes < 1000) return bytes + " B";
  return bytes < 1e6 ? (bytes / 1e3).toFixed(0) + " kB" : (bytes / 1e6).toFixed(1) + " MB";
}

/** A local time with its day. @param {number} seconds since 1970 */
function time(seconds) {
  const at = new Date(seconds * 1000), two = (/** @type {number} */ value) => String(value).padStart(2, "0");
  return [at.getFullYear(), two(at.getMonth() + 1), two(at.getDate())].join("-") + " " + [at.getHours(), at.getMinutes(), at.getSeconds()].map(two).join(":");
}

/** The causes of a file; the hints of each in its title. @param {Json} flight */
function cause(flight) {
  if (flight.complete !== true && flight.complete !== "true") return state("writing");
  if (flight.error) return make("span", flight.error, "warn");
  const lines = String(flight.cause ?? "").split("\n"), box = make("span", lines[0]);
  if (lines.length > 1) {
    box.append(make("small", " and " + (lines.length - 1) + " more", "dim"));
    box.title = lines.join("\n");
  }
  return box;
}

/** @param {Json} flight */
function row(flight) {
  const link = make("a", flight.name);
  if (flight.complete === true || flight.complete === "true") {
    link.setAttribute("href", flight.uri);
    link.setAttribute("download", flight.name);
  }
  return { cells: [time(Number(flight.changed)), cause(flight), { number: size(Number(flight.bytes)) }, link] };
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const box = section("Flight recordings"), form = /** @type {HTMLFormElement} */ (make("form", undefined, "row")), files = make("div");
  const note = /** @type {HTMLInputElement} */ (make("input")), place = make("p", "", "dim");
  box.id = "flights";
  note.type = "text";
  note.size = 32;
  note.maxLength = 200;
  note.placeholder = "cause, for the list";
  note.setAttribute("aria-label", "Cause of the recording");
  const record = /** @type {HTMLButtonElement} */ (button("Record now", () => app.act(async () => {
    await app.post("/flights/", note.value ? { cause: note.value } : {});
    note.value = "";
    await update();
  })));
  let canRecord = false;
  // The button is disabled while it is pressed, and enabled again by itself.
  const enable = () => { record.disabled = note.disabled = !(canRecord && app.hasControl()); };
  form.onsubmit = event => { event.preventDefault(); record.click(); };
  form.append(record, note);
  box.append(make("p", "The last ten seconds of all devices at full rate, with nets and log, are written when a device faults, a net fails or cycles are "
    + "missed in a burst, and on request, together with the second that follows. Foxglove, Lichtblick and PlotJuggler open the files.", "dim"), form, place, files);
  element.append(box);
  app.onControl(enable);
  async function update() {
    const flights = await app.get("/flights/");
    canRecord = flights.recording === true || flights.recording === "true";
    enable();
    place.textContent = canRecord ? "Files are in " + flights.directory + ", the oldest are deleted first."
      : "The flight recorder is off: set flight_recorder under [controller] of cell.toml to a directory.";
    swap(files, table(["written", "cause", "size", "file"], list(flights, "flight").reverse().map(row), "no flight recordings"));
  }
  app.every(PERIOD_MS, update);
}

/** @type {import("./api.js").View} */
export const view = { id: "flights", title: "Flights", mount, unmount() {} };
