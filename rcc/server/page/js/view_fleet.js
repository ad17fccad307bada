// The cells of the fleet that this controller has joined, as it sees them.

import { list, make, section, state, swap, table } from "./dom.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** What a cell is like, in a word. @param {Json} cell */
const word = cell => cell.summary?.state ?? (cell.alive ? "silent" : "lost");

/** The page of a cell, if this browser can reach it: an address of loopback is that of the own host.
 * @param {Json} cell @param {string | undefined} host the host of this controller @returns {string | null} */
function pageOf(cell, host) {
  const address = cell.info?.http;
  if (!address) return null;
  const isLoopback = /^(127\.|\[::1\]|localhost)/.test(address);
  return isLoopback && cell.info.host !== host ? null : location.protocol + "//" + address + "/";
}

/** @param {Json} cell @param {string} own @param {string | undefined} host */
function row(cell, own, host) {
  const { info, summary } = cell, page = pageOf(cell, host), name = make(page && cell.cell !== own ? "a" : "b", cell.cell);
  if (page && cell.cell !== own) name.setAttribute("href", page);
  /** @param {string} key */
  const count = key => ({ number: summary?.[key] ?? "—" });
  return { cells: [name, state(word(cell)), summary ? summary.operational + " of " + summary.devices : "—", count("running"), count("missed"),
    summary?.worst ?? "", info?.host ?? "", info?.version ?? "", String(cell.boots?.[0] ?? "").slice(0, 8)] };
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const box = section("Fleet");
  box.id = "fleet";
  element.append(box);
  app.every(1000, async () => {
    const head = make("h2", "Fleet");
    try {
      const { own, cells } = await app.get("/fleet/");
      if (own === null) { swap(box, head, make("p", "This controller is in no fleet. A table [fleet] in its cell file lets it join one.", "dim")); return; }
      const host = list({ cells }, "cells").find(cell => cell.cell === own)?.info?.host;
      swap(box, head, table(["cell", "state", "devices in operation", "nets count", "missed count", "worst finding", "host", "version", "boot"],
        cells.map((/** @type {Json} */ cell) => row(cell, own, host)), "no cell is alive"));
    } catch (error) {
      swap(box, head, make("p", error instanceof Error ? error.message : String(error), "dim"));
    }
  });
}

/** @type {import("./api.js").View} */
export const view = { id: "fleet", title: "Fleet", mount, unmount() {} };
