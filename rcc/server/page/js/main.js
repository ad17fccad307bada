// Start of the page: views by the hash, the control switch, STOP, and whether the controller answers.

import { get, post, text } from "./api.js";
import { byId, make } from "./dom.js";
import { connectStop, pollStop } from "./stop.js";

/** @typedef {import("./api.js").View} View */

/** The views, in the order of the navigation. Each module is loaded when its view is first opened, so that a view that a browser
 * cannot run takes no other with it.
 * `needs` are the modules that it imports, and these import: they are fetched at once, not one after the other.
 * @type {{ id: string, title: string, load: () => Promise<{ view: View }>, needs: string[] }[]} */
const VIEWS = [
  { id: "overview", title: "Overview", load: () => import("./view_overview.js"), needs: [] },
  { id: "cell", title: "Cell", load: () => import("./view_3d.js"), needs: ["camera", "geometry", "live", "math3", "meshes", "scene", "scope", "scopes", "solids", "stl", "webgl"] },
  { id: "plots", title: "Plots", load: () => import("./view_plots.js"), needs: ["plot", "plot_input", "probe_picker", "samples", "scope", "scopes", "trigger"] },
  { id: "nets", title: "Nets", load: () => import("./view_nets.js"), needs: ["net_graph", "rule_graph", "svg"] },
  { id: "machines", title: "Machines", load: () => import("./view_machines.js"), needs: ["svg"] },
  { id: "devices", title: "Devices", load: () => import("./view_devices.js"), needs: ["view_overview"] },
  { id: "jog", title: "Jog", load: () => import("./view_jog.js"), needs: ["directio", "jog", "view_overview"] },
  { id: "buses", title: "Buses", load: () => import("./view_buses.js"), needs: ["view_overview"] },
  { id: "threads", title: "Threads", load: () => import("./view_threads.js"), needs: [] },
  { id: "fleet", title: "Fleet", load: () => import("./view_fleet.js"), needs: [] },
  { id: "flights", title: "Flights", load: () => import("./view_flights.js"), needs: [] },
  { id: "log", title: "Log", load: () => import("./view_log.js"), needs: [] },
];

/** Interval of the header, ms. */
const PERIOD_MS = 1000;
/** A view waits for so long while a button of the pointer is down, ms. */
const PRESSED_MS = 60;
/** How long an error is shown, ms. */
const NOTICE_MS = 12000;

/** @type {View | null} */
let mounted = null;
let isControlled = false;
/** Whether a button of the pointer is down. */
let isPressed = false;
/** @type {import("./dom.js").Json} */
let status = {};
/** Ends what the mounted view started. @type {(() => void)[]} */
let ends = [];
/** @type {((on: boolean) => void)[]} */
let controlled = [];
let noticeTimer = 0;

/** @param {unknown} error */
const words = error => error instanceof Error ? error.message : String(error);

/** @param {string} text */
function notice(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = !text;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => { byId("notice").hidden = true; }, NOTICE_MS);
}

/** @param {string} text @param {"good" | "bad"} kind */
function showLive(text, kind) {
  byId("live").textContent = text.slice(0, 80);
  byId("live").className = "state " + kind;
}

/** @param {number} period_ms @param {() => unknown} work */
function every(period_ms, work) {
  let isOver = false;
  const round = async () => {
    if (isOver) return;
    // What a pointer is about to press stays where it is.
    if (isPressed) { setTimeout(round, PRESSED_MS); return; }
    try { if (!document.hidden) await work(); }
    catch (error) { if (!isOver) showLive(words(error), "bad"); }
    if (!isOver) setTimeout(round, period_ms);
  };
  ends.push(() => { isOver = true; });
  round();
}

const parts = () => location.hash.slice(1).split("/").map(decodeURIComponent);

/** @type {import("./api.js").App} */
const app = {
  get, post, text, every, notice,
  hasControl: () => isControlled,
  onControl: change => { controlled.push(change); change(isControlled); },
  act: async press => {
    if (!isControlled) { notice("The control switch is off.\nhint: switch it on in the header; this page only reads until then."); return; }
    try { await press(); } catch (error) { notice(words(error)); }
  },
  status: () => status,
  go: (...path) => { location.hash = path.map(encodeURIComponent).join("/"); },
  picked: () => parts().slice(1),
};

/** Fetches modules that are about to be imported. @param {string[]} modules */
function preload(modules) {
  for (const name of modules) {
    const href = `/page/js/${name}.js`;
    if (document.head.querySelector(`link[href="${href}"]`)) continue;
    const link = make("link");
    link.setAttribute("rel", "modulepreload");
    link.setAttribute("href", href);
    document.head.append(link);
  }
}

/** Number of the last change of the view, so that a module that loads slowly replaces no newer view. */
let change = 0;

async function openView() {
  const known = VIEWS.find(view => view.id === parts()[0]) ?? VIEWS[0];
  const number = ++change;
  for (const link of byId("views").children) {
    if (link.getAttribute("href") === "#" + known.id) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  const nav = byId("views"), at = /** @type {HTMLElement | null} */ (nav.querySelector("[aria-current]"));
  // On a narrow display the names of views scroll: the present one is in the middle.
  if (at) nav.scrollLeft = at.offsetLeft - (nav.clientWidth - at.offsetWidth) / 2;
  document.title = known.title + " · Takt";
  const close = () => {
    mounted?.unmount();
    ends.forEach(end => end());
    [mounted, ends, controlled] = [null, [], []];
    byId("view").replaceChildren();
  };
  preload(known.needs);
  try {
    const { view } = await known.load();
    if (number !== change) return;
    close();
    mounted = view;
    view.mount(byId("view"), app);
  } catch (error) {
    if (number !== change) return;
    close();
    byId("view").append(make("section", "This view failed: " + words(error), "bad"));
  }
}

async function poll() {
  try {
    status = await get("/status/");
    byId("subtitle").textContent = "robot control core " + status.version + " at " + location.host;
    await pollStop();
    showLive("live", "good");
  } catch (error) {
    showLive(words(error), "bad");
  }
  setTimeout(poll, PERIOD_MS);
}

/** @param {boolean} on */
function setControl(on) {
  isControlled = on;
  /** @type {HTMLInputElement} */ (byId("control")).checked = on;
  document.body.classList.toggle("control", on);
  controlled.forEach(change => change(on));
}

byId("views").append(...VIEWS.map(({ id, title }) => {
  const link = make("a", title);
  link.setAttribute("href", "#" + id);
  return link;
}));
byId("control").onchange = event => setControl(/** @type {HTMLInputElement} */ (event.target).checked);
// A browser restores switches when it reloads a page; control begins off.
setControl(false);
connectStop();
addEventListener("hashchange", openView);
addEventListener("pointerdown", () => { isPressed = true; }, true);
for (const end of ["pointerup", "pointercancel", "blur"]) addEventListener(end, () => { isPressed = false; }, true);
poll();
openView();
