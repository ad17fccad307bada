// Requests to the controller that served this page. A token is in a cookie that scripts cannot read.

/** @typedef {import("./dom.js").Json} Json */

/** What a view gets from the page.
 * @typedef {Object} App
 * @property {(path: string) => Promise<Json>} get a resource as JSON
 * @property {(path: string, fields: Record<string, string>) => Promise<void>} post sends a form; rejected with cause and hint
 * @property {(path: string) => Promise<string>} text a resource as text
 * @property {(period_ms: number, work: () => unknown) => void} every calls `work` now and then at this interval while the view is
 *   mounted and the page is visible; an error is shown, and the next call follows
 * @property {() => boolean} hasControl whether the control switch is on
 * @property {(change: (on: boolean) => void) => void} onControl calls `change` when the switch changes, while the view is mounted
 * @property {(press: () => Promise<unknown>) => Promise<void>} act runs an action if the switch is on, and shows its error
 * @property {() => Json} status the latest `/status/`
 * @property {(text: string) => void} notice shows an error until the next one, or for some seconds
 * @property {(...path: string[]) => void} go opens a view, with what is picked in it: the hash becomes `#id/picked`
 * @property {() => string[]} picked what is picked in this view: the parts of the hash behind the id
 */
/** A view: one panel of the page.
 * @typedef {Object} View
 * @property {string} id its name in the hash
 * @property {string} title
 * @property {(element: HTMLElement, app: App) => void} mount fills the element; what it starts ends with `unmount`
 * @property {() => void} unmount
 */

/** After this time a request has failed, ms. */
const TIMEOUT_MS = 5000;

/** @param {string} path @param {RequestInit} [init] */
async function request(path, init = {}) {
  const limit = AbortSignal.timeout ? AbortSignal.timeout(TIMEOUT_MS) : undefined;
  const answer = await fetch(path, { cache: "no-store", signal: limit, ...init });
  if (!answer.ok) throw new Error((await answer.text()).trim() || path + ": " + answer.status);
  return answer;
}

/** @param {string} path @returns {Promise<Json>} */
export async function get(path) {
  const answer = await request(path, { headers: { Accept: "application/json" } });
  return answer.json();
}

/** @param {string} path */
export async function text(path) {
  return (await request(path)).text();
}

/** @param {string} path @param {Record<string, string>} fields */
export async function post(path, fields) {
  // The answer may redirect to the resource; what it shows is polled anyway.
  await request(path, { method: "POST", body: new URLSearchParams(fields), headers: { Accept: "application/json" } });
}
