// The whole controller at a glance: usage, threads, devices, machines, nets, sessions.

import { figure, figures, list, make, note, section, span, state, swap, table } from "./dom.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** The joints of an arm, rad; "—" while unknown. @param {Json} arm */
export function joints(arm) {
  const positions = list(arm, "joint").map(joint => isNaN(parseFloat(joint.measured)) ? "—" : Number(joint.measured).toFixed(3));
  return { values: [...positions, "rad"] };
}

/** Configured devices: the device `rcc` stands for the controller, for programs. @param {Json} devices */
export const configured = devices => list(devices, "device").filter(device => device.type !== "rcc");

/** Names of the interfaces of a device. @param {Json} device */
export const interfaces = device => list(device, "interface").map(it => String(it.name));

/** Path of a device below the root. @param {string} name */
export const pathOf = name => "/devices/" + encodeURIComponent(name) + "/";

/** A row for each device, and its last event as long as it says what is wrong. @param {Json} devices @param {App} app */
export async function deviceRows(devices, app) {
  const notes = [];
  const rows = await Promise.all(configured(devices).map(async device => {
    const names = interfaces(device);
    const last = names.includes("robotarm") ? joints(await app.get(pathOf(device.name) + "robotarm")) : names.join(", ");
    const pick = () => app.go("devices", device.name);
    return { cells: [device.name, device.type, state(device.state), last], pick };
  }));
  for (const device of configured(devices)) {
    const wrong = list(device, "event").slice(-1).filter(event => event.severity !== "info");
    notes.push(...wrong.map(event => note(device.name, event)));
  }
  return { rows, notes };
}

/** @param {Json} status */
function counts(status) {
  const used = list(status, "count").map(count =>
    figure(count.name, count.used + " of " + count.bound, Number(count.used) > 0.8 * Number(count.bound) ? "warn" : ""));
  const allocations = Number(status.allocations);
  return figures(...used, figure("real-time allocations", allocations, allocations ? "bad" : "good"));
}

/** @param {Json} thread */
function threadRow(thread) {
  const [latency, execution] = [list(thread, "latency")[0], list(thread, "execution")[0]];
  const clock = list(thread, "phaseerror")[0];
  const missed = Number(thread.missed);
  return { cells: [thread.name, { number: span(thread.period) }, { number: thread.cycles },
    make("span", missed, missed ? "warn" : "good"), { number: span(latency?.p99) }, { number: span(latency?.max) },
    { number: span(execution?.p99) }, clock ? clock.state + " to " + clock.device : ""] };
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const boxes = {
    counts: section("Controller"), threads: section("Threads"), devices: section("Devices"),
    machines: section("Machines", "half"), nets: section("Nets", "half"), sessions: section("Sessions"),
  };
  for (const [id, box] of Object.entries(boxes)) box.id = id;
  element.append(...Object.values(boxes));
  /** @param {HTMLElement} box @param {...Node} children */
  const fill = (box, ...children) => swap(box, /** @type {Node} */ (box.firstChild).cloneNode(true), ...children);
  app.every(1000, async () => {
    const [status, devices, nets, machines, sessions] =
      await Promise.all(["/status/", "/devices/", "/nets/", "/machines/", "/sessions/"].map(app.get));
    fill(boxes.counts, counts(status));
    fill(boxes.threads, table(["thread", "period ms", "cycles count", "missed", "latency p99 ms", "max ms", "work p99 ms", "clock"],
      list(status, "thread").map(threadRow), "no threads"));
    const { rows, notes } = await deviceRows(devices, app);
    fill(boxes.devices, table(["name", "type", "state", "joints or interfaces"], rows, "no devices"), ...notes);
    fill(boxes.nets, table(["net", "state", "description"], list(nets, "net").slice(-12).reverse().map(net => {
      const name = net.uri.split("/")[2];
      return { cells: [name, state(net.status), net.desc], pick: () => app.go("nets", name) };
    }), "no nets"));
    fill(boxes.machines, table(["machine", "status", "state", "error"], list(machines, "machine").map(machine =>
      ({ cells: [machine.name, state(machine.status), machine.state, machine.error], pick: () => app.go("machines", machine.name) })), "no machines"));
    fill(boxes.sessions, table(["session", "description", "nets when its client is lost"],
      list(sessions, "session").map(session => ({ cells: [session.id, session.desc, session.onloss] })), "no sessions"));
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "overview", title: "Overview", mount, unmount() {} };
