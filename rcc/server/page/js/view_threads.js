// Threads with their histograms, and the findings of the host check.

import { bars, figure, figures, list, make, section, span, swap, table } from "./dom.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** @param {Json} thread */
function threadBox(thread) {
  const [latency, execution] = [list(thread, "latency")[0], list(thread, "execution")[0]], missed = Number(thread.missed);
  const clocks = list(thread, "phaseerror");
  const box = section(thread.name, "half");
  box.append(figures(figure("period", span(thread.period)), figure("cycles", thread.cycles), figure("missed", missed, missed ? "warn" : "good"),
    ...clocks.flatMap(clock => [
      figure("clock of " + clock.device, clock.state, ["locked", "stable", "holdover"].includes(clock.state) ? "good" : "warn"),
      figure("phase", span(clock.phase))])));
  const shown = /** @type {[string, Json][]} */ ([["Latency", latency], ["Work", execution], ...clocks.map(clock => ["Phase error", clock])]);
  for (const [name, it] of shown) {
    if (!it || !Number(it.count)) continue;
    box.append(make("h3", name + ": median " + span(it.p50) + ", 99 % " + span(it.p99) + ", max " + span(it.max)), bars(it));
  }
  box.append(make("p", "Bars: cycles, logarithmic.", "dim"));
  return box;
}

/** @param {Json} found */
function findings(found) {
  const bad = list(found, "conditions").filter(it => it.status === "WARN" || it.status === "FAIL"), { summary } = found;
  const rows = bad.sort((a, b) => a.status.localeCompare(b.status)).map(it => {
    const text = make("div");
    text.append(it.read, make("br"), make("span", it.why, "dim"));
    return { cells: [make("span", it.status, "state " + (it.status === "FAIL" ? "bad" : "warn")), it.name, text, { value: it.remedy }] };
  });
  return [make("p", `${summary.ok} ok, ${summary.warn} WARN, ${summary.fail} FAIL, ${summary.skip} skip`, "dim"),
    table(["status", "condition", "found, and why it matters", "remedy"], rows, "this host is fit for real time")];
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const threads = make("div", undefined, "grid"), host = section("Host check");
  [threads.id, host.id] = ["threads", "host"];
  element.append(threads, host);
  app.every(1000, async () => {
    swap(threads, ...list(await app.get("/status/"), "thread").map(threadBox));
  });
  app.every(30000, async () => {
    let parts;
    try { parts = findings(await app.get("/host/")); }
    catch (error) { parts = [make("p", error instanceof Error ? error.message : String(error), "dim")]; }
    swap(host, make("h2", "Host check"), ...parts);
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "threads", title: "Threads", mount, unmount() {} };
