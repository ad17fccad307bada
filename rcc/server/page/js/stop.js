// STOP: by two paths at once, the stop channel with a port and thread of its own, and this server. It is no safety function.

import { get } from "./api.js";
import { byId } from "./dom.js";

/** Port and key of the stop channel, read in advance: it works even when the server does not answer.
 * @type {{ port: string, key: string } | null} */
let channel = null;

/** @param {boolean} isStopped @param {string} by */
function show(isStopped, by) {
  byId("stopped").hidden = byId("release").hidden = !isStopped;
  byId("stopped").textContent = isStopped ? "stopped by " + by : "";
}

/** @param {"" | "release"} action */
async function send(action) {
  const requests = [fetch("/stop/" + action, { method: "POST", headers: { Accept: "application/json" } })];
  if (channel) {
    const path = "/stop" + (action && "/" + action) + "?key=" + channel.key;
    requests.unshift(fetch("//" + location.hostname + ":" + channel.port + path, { method: "POST" }));
  }
  const done = requests.map(async request => {
    const answer = await request;
    if (!answer.ok) throw new Error(await answer.text());
  });
  try {
    await Promise.any(done);
    show(!action, "this page");
  } catch {
    byId("stopped").hidden = false;
    byId("stopped").textContent = "NO ANSWER to " + (action || "stop") + ": press the robot's emergency stop";
  }
}

/** Connects the buttons. */
export function connectStop() {
  byId("stop").onclick = () => send("");
  byId("release").onclick = () => send("release");
}

/** Shows whether everything is stopped, and keeps port and key. */
export async function pollStop() {
  const state = await get("/stop/");
  if (state.port) channel = { port: state.port, key: state.key };
  show(state.stopped === "true" || state.stopped === true, state.by || "another client");
}
