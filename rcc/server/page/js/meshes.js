// The meshes that models of arms name: read once each, and only a few at a time. What cannot be read is drawn as simple solids.

import { pieces, readStl } from "./stl.js";

/** @typedef {import("./geometry.js").Solid} Solid */
/** @typedef {ReturnType<typeof pieces>} Pieces */

/** Meshes that are kept, and requests at once. */
const KEPT_MAX = 128, AT_ONCE = 4;
/** After this time a request has failed, ms. */
const TIMEOUT_MS = 20000;

/** What is known of a mesh: its pieces, or why there are none. @type {Map<string, { pieces: Pieces | null, why: string }>} */
const known = new Map();

/** @param {Solid} solid */
const keyOf = solid => solid.uri + " " + solid.scale.join();

/** The pieces of a mesh; null if they are not there. @param {Solid} solid */
export const piecesOf = solid => known.get(keyOf(solid))?.pieces ?? null;

/** @param {Solid} solid */
async function read(solid) {
  try {
    const answer = await fetch(solid.uri, { cache: "no-store", signal: AbortSignal.timeout?.(TIMEOUT_MS) });
    if (!answer.ok) throw new Error((await answer.text()).trim() || "status " + answer.status);
    return { pieces: pieces(readStl(await answer.arrayBuffer()), solid.scale), why: "" };
  } catch (error) {
    return { pieces: null, why: error instanceof Error ? error.message : String(error) };
  }
}

/** Reads what is not known yet of these meshes. @param {Solid[]} solids
 * @returns {Promise<string[]>} why some cannot be drawn, a line each */
export async function readMeshes(solids) {
  const wanted = new Map(solids.map(solid => [keyOf(solid), solid]));
  for (const key of [...known.keys()]) if (!wanted.has(key) && known.size > KEPT_MAX) known.delete(key);
  const missing = [...wanted].filter(([key]) => !known.has(key)).slice(0, KEPT_MAX);
  const work = async () => {
    for (let next = missing.shift(); next; next = missing.shift()) known.set(next[0], await read(next[1]));
  };
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return [...wanted].flatMap(([key, solid]) => {
    const why = known.has(key) ? known.get(key)?.why : "there are more than " + KEPT_MAX + " meshes";
    return why ? [solid.file + ": " + why] : [];
  });
}
