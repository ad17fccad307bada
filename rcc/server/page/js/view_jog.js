// Jogging: hold a button and the arm moves. It is no safety function.

import { byId, list, make, section, state, swap, table } from "./dom.js";
import { Jog } from "./jog.js";
import { configured, interfaces, pathOf } from "./view_overview.js";

/** @typedef {import("./dom.js").Json} Json @typedef {import("./api.js").App} App */

/** Speeds, as parts of the limits. */
const SPEEDS = [0.01, 0.03, 0.1, 0.25];
const AXES = ["x", "y", "z", "rx", "ry", "rz"];

/** @type {Jog | null} */
let jog = null;
/** Takes back what mount added to the window. @type {() => void} */
let forget = () => {};

function close() {
  jog?.close();
  jog = null;
}

/** A button that counts as held from its press until its release, and never longer than it has the keyboard or the pointer.
 * @param {string} direction @param {(direction: string) => void} hold @param {() => void} release */
function holdButton(direction, hold, release) {
  const element = /** @type {HTMLButtonElement} */ (make("button", direction.slice(-1) === "+" ? "+" : "−", "hold"));
  element.type = "button";
  element.setAttribute("aria-label", "Hold to move " + direction);
  element.dataset.direction = direction;
  const isKey = (/** @type {KeyboardEvent} */ event) => event.key === " " || event.key === "Enter";
  const press = () => { element.classList.add("held"); hold(direction); };
  const end = () => { element.classList.remove("held"); release(); };
  element.onpointerdown = event => { if (event.button) return; event.preventDefault(); element.focus(); element.setPointerCapture(event.pointerId); press(); };
  element.onpointerup = element.onpointercancel = element.onlostpointercapture = element.onblur = end;
  element.onkeydown = event => { if (isKey(event)) { event.preventDefault(); if (!event.repeat) press(); } };
  element.onkeyup = event => { if (isKey(event)) end(); };
  element.oncontextmenu = event => event.preventDefault();
  return element;
}

/** @param {HTMLElement} element @param {App} app */
function mount(element, app) {
  const box = section("Jog"), bar = make("div", undefined, "row"), pads = make("div", undefined, "pads"), joints = make("div");
  const message = make("p", "", "dim");
  const choose = (/** @type {string} */ name, /** @type {string[]} */ options) => {
    const select = /** @type {HTMLSelectElement} */ (make("select"));
    select.setAttribute("aria-label", name);
    select.append(...options.map(option => make("option", option)));
    return select;
  };
  const arms = choose("Arm", []), kinds = choose("What moves", ["joints", "flange"]), speeds = choose("Speed", SPEEDS.map(speed => speed * 100 + " % of its limits"));
  speeds.selectedIndex = 2;
  const enable = /** @type {HTMLButtonElement} */ (make("button", "Enable"));
  [enable.id, message.id, pads.id, joints.id, arms.id, kinds.id, speeds.id] = ["enable", "jog-message", "pads", "jog-joints", "jog-arm", "jog-kind", "jog-speed"];
  bar.append(arms, kinds, speeds, enable);
  box.append(bar, message, pads, joints, make("p", "The arm moves while a button is held, and brakes when it is released, the page loses the focus, or the "
    + "connection stalls for 0.1 s. This is no safety function: where people are at risk, use the enabling switch and the emergency stop of the robot.", "dim"));
  element.append(box);
  /** Velocity limits of the joints of the picked arm, rad/s. @type {number[]} */
  let limits = [];
  let isOn = false, isBusy = false;
  const say = (/** @type {string} */ text, kind = "dim") => { message.textContent = text; message.className = kind; };
  const update = () => {
    enable.textContent = jog ? "Disable" : "Enable";
    enable.disabled = !isOn || isBusy || !arms.value;
    [arms, kinds, speeds].forEach(select => { select.disabled = !!jog || isBusy; });
    pads.querySelectorAll("button").forEach(button => { button.disabled = !jog || isBusy; });
  };
  const stop = (/** @type {string} */ why, kind = "dim") => { close(); say(why, kind); update(); };
  const release = (/** @type {string} */ why) => jog?.release(why);
  const draw = () => {
    const directions = kinds.value === "joints" ? limits.map((_, number) => "j" + number) : AXES;
    pads.replaceChildren(...directions.map(axis => {
      const pad = make("div", undefined, "pad");
      const hold = (/** @type {string} */ direction) => { say("moves " + direction, "warn"); jog?.hold(direction); };
      const end = () => { if (jog?.held) { jog.release(); say("at rest"); } };
      pad.append(holdButton(axis + "-", hold, end), make("b", axis), holdButton(axis + "+", hold, end));
      return pad;
    }));
    update();
  };
  enable.onclick = async () => {
    if (jog) { stop("disabled"); return; }
    isBusy = true;
    update();
    const name = arms.value, kind = /** @type {"joints" | "flange"} */ (kinds.value), speed = SPEEDS[speeds.selectedIndex];
    const made = new Jog({ kind, limits, released: why => say("released: " + why, "warn"), ended: why => { jog = null; say(why, "bad"); update(); } });
    try {
      await made.begin(await app.text(pathOf(name) + "jog?kind=" + kind + "&speed=" + speed), name);
      jog = made;
      say("enabled: hold a button");
    } catch (error) {
      made.close();
      say(error instanceof Error ? error.message : String(error), "bad");
    }
    isBusy = false;
    // The view or the switch may have changed meanwhile.
    if (!isOn || !box.isConnected) close();
    update();
  };
  app.onControl(on => { isOn = on; if (!on && jog) stop("the control switch is off"); update(); });
  const lost = () => release("the page lost the focus");
  const hidden = () => { if (document.hidden) release("the page is hidden"); };
  const stopped = () => release("stopped");
  addEventListener("blur", lost);
  document.addEventListener("visibilitychange", hidden);
  byId("stop").addEventListener("pointerdown", stopped);
  forget = () => {
    removeEventListener("blur", lost);
    document.removeEventListener("visibilitychange", hidden);
    byId("stop").removeEventListener("pointerdown", stopped);
  };
  kinds.onchange = draw;
  arms.onchange = () => { limits = []; app.go("jog", arms.value); };
  app.every(200, async () => {
    const all = configured(await app.get("/devices/")).filter(device => interfaces(device).includes("robotarm")), names = all.map(device => String(device.name));
    if (names.join() !== [...arms.options].map(option => option.text).join()) {
      arms.replaceChildren(...names.map(name => make("option", name)));
      const picked = names.indexOf(app.picked()[0]);
      if (picked >= 0) arms.selectedIndex = picked;
    }
    const arm = all.find(device => device.name === arms.value);
    if (!arm) { say("no arms"); return; }
    const own = list(arm, "limits").map(limit => Number(limit.velocitymax));
    if (own.join() !== limits.join()) { limits = own; draw(); }
    const shown = list(await app.get(pathOf(arm.name) + "robotarm"), "joint");
    /** @param {any} value rad @returns {import("./dom.js").Cell[]} in degrees and rad */
    const both = value => isNaN(parseFloat(value)) ? ["—", "—"] : [{ number: (Number(value) * 180 / Math.PI).toFixed(2) }, { number: Number(value).toFixed(4) }];
    const head = make("h3", arm.name + " ");
    head.append(state(arm.state));
    swap(joints, head, table(["joint", "measured °", "measured rad", "velocity °/s", "velocity rad/s"], shown.map(joint =>
      ({ cells: ["J" + joint.axis, ...both(joint.measured), ...both(joint.velocity)] })), "no joints"));
    if (jog?.net) {
      const net = await app.get("/nets/" + jog.net + "/").catch(() => null);
      if (jog && net?.status !== "RUNNING" && net?.status !== "READY" && net?.status !== "SCHEDULED") {
        const cause = list(net ?? {}, "data").filter(value => /^out(failed|illegal|concurrent|unreachable|fast)_/.test(value.key) && value.text === "true");
        stop("the jog ended: " + (net?.end ?? (cause.map(value => value.key.slice(3).replace("_", " of ")).join(", ") || "its net is not loaded any more")), "bad");
      }
    }
  });
  draw();
}

/** @type {import("./api.js").View} */
export const view = { id: "jog", title: "Jog", mount, unmount() { close(); forget(); } };
