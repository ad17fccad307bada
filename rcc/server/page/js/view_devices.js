// Devices: state, cause and remedy of what is wrong, joints within their ranges, inputs and outputs, figures of the driver.

import { button, figure, figures, list, make, note, section, state, swap, table } from "./dom.js";
import { configured, interfaces, pathOf } from "./view_overview.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** Ports of a kind that are shown. */
const PORTS_MAX = 64;
/** @param {number} value */
const fixed = value => isFinite(value) ? value.toFixed(4) : "—";

/** A bar from the lower to the upper end of a joint, with a mark where it is. @param {number} value @param {Json | undefined} limits */
function range(value, limits) {
  const box = make("div", undefined, "range"), mark = make("i");
  const [low, high] = [Number(limits?.positionmin), Number(limits?.positionmax)], at = (value - low) / (high - low);
  if (!isFinite(at)) return box;
  mark.style.left = Math.min(100, Math.max(0, 100 * at)) + "%";
  if (at < 0.03 || at > 0.97) mark.className = "near";
  box.title = fixed(low) + " to " + fixed(high) + " rad";
  box.append(mark);
  return box;
}

/** @param {App} app @param {Json} device */
async function joints(app, device) {
  const arm = await app.get(pathOf(device.name) + "robotarm");
  const rows = list(arm, "joint").map(joint => {
    const limits = list(device, "limits")[Number(joint.axis)], [measured, commanded] = [Number(joint.measured ?? NaN), Number(joint.commanded ?? NaN)];
    const error = Number(joint.error);
    return { cells: ["J" + joint.axis, range(measured, limits), { number: fixed(measured) }, { number: fixed(commanded) },
      { number: (1000 * (measured - commanded)).toFixed(2).replace("NaN", "—") }, { number: fixed(Number(joint.velocity ?? NaN)) },
      error ? make("span", "error " + error, "bad") : ""] };
  });
  return table(["joint", "range", "measured rad", "commanded rad", "difference mrad", "velocity rad/s", ""], rows, "no joints");
}

/** Ports by kind; outputs can be set. @param {App} app @param {Json} device */
async function ports(app, device) {
  const path = pathOf(device.name) + "io", all = list(await app.get(path), "port").slice(0, 4 * PORTS_MAX), box = make("div");
  /** @param {Json} port @param {string} value */
  const set = (port, value) => app.act(() => app.post(path, { id: String(port.id), type: port.type, value }));
  for (const kind of ["digin", "digout", "anin", "anout"]) {
    const own = all.filter(port => port.type === kind).slice(0, PORTS_MAX), row = make("div", undefined, "row ports");
    if (!own.length) continue;
    for (const port of own) {
      const isOn = String(port.value) === "true", isDigital = kind.startsWith("dig");
      const text = port.id + (isDigital ? "" : " " + (port.value ?? "—"));
      if (kind === "digout") {
        const toggle = button(text, () => set(port, String(!isOn)), isOn ? "on" : "");
        toggle.setAttribute("aria-pressed", String(isOn));
        toggle.disabled = !app.hasControl();
        row.append(toggle);
      } else if (kind === "anout") {
        const edit = button(text, () => {
          const value = prompt(device.name + ", analogue output " + port.id, String(port.value ?? 0));
          return value === null ? undefined : set(port, value);
        });
        edit.disabled = !app.hasControl();
        row.append(edit);
      } else row.append(make("span", text, "port" + (isOn ? " on" : "")));
    }
    box.append(make("h3", kind), row);
  }
  return box;
}

/** @param {App} app @param {string} name */
async function details(app, name) {
  const device = await app.get(pathOf(name)), names = interfaces(device), parts = [make("h2", name)];
  const row = make("div", undefined, "row");
  row.append(state(device.state), make("span", device.type, "dim"), make("span", names.join(", "), "dim"));
  const link = make("a", "values of its last second (CSV)");
  link.setAttribute("href", pathOf(name) + "last");
  row.append(link);
  parts.push(row);
  const drawn = list(device, "figure").map(it => figure(it.name, it.value));
  if (drawn.length) parts.push(make("h3", "Driver"), figures(...drawn));
  if (names.includes("robotarm")) parts.push(make("h3", "Joints"), await joints(app, device));
  if (names.includes("io")) parts.push(await ports(app, device).catch(error => make("p", "inputs and outputs: " + error.message, "dim")));
  const events = list(device, "event").slice(-12).reverse().map(event => note(event.severity, event));
  parts.push(make("h3", "Events"), ...(events.length ? events : [make("p", "none", "dim")]));
  return parts;
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const devices = section("Devices", "third"), detail = section("", "two-thirds detail");
  [devices.id, detail.id] = ["devices", "device"];
  element.append(devices, detail);
  app.every(500, async () => {
    const all = configured(await app.get("/devices/")), picked = app.picked()[0] ?? all[0]?.name;
    const rows = all.map(device => ({
      cells: [device.name, device.type, state(device.state)], pick: () => app.go("devices", device.name), isPicked: device.name === picked,
    }));
    const wrong = all.flatMap(device => list(device, "event").slice(-1).filter(event => event.severity === "error").map(event => note(device.name, event)));
    swap(devices, make("h2", "Devices"), table(["name", "type", "state"], rows, "no devices"), ...wrong);
    swap(detail, ...picked ? await details(app, picked) : [make("p", "no devices", "dim")]);
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "devices", title: "Devices", mount, unmount() {} };
