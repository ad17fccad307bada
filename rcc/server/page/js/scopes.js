// Any number of probes: as many connections to `/scope` as they need, used like one.

import { PROBES_MAX, Scope } from "./scope.js";

/** @typedef {import("./scope.js").Handlers} Handlers */
/** @typedef {import("./scope.js").Query} Query */
/** @typedef {import("./scope.js").Group} Group */
/** @typedef {import("./scope.js").Rejected} Rejected */

/** Most connections; probes beyond them are rejected here. */
const CONNECTIONS_MAX = 8;

/** The probes in parts of at most that length. @param {string[]} names @param {number} most @returns {string[][]} */
export function parts(names, most) {
  const count = Math.ceil(names.length / most);
  return Array.from({ length: count }, (_, part) => names.slice(part * most, (part + 1) * most));
}

export class Scopes {
  /** @param {Handlers} handlers @param {string} [url] */
  constructor(handlers, url) {
    this.handlers = handlers;
    this.url = url;
    /** What each connection samples; null before it has answered. @type {{ scope: Scope, groups: Group[] | null, rejected: Rejected[] }[]} */
    this.all = [];
    /** @type {Rejected[]} */
    this.surplus = [];
  }

  /** Asks for these probes instead of all before. @param {Query} query */
  ask(query) {
    const queries = parts(query.probes, PROBES_MAX);
    this.surplus = queries.splice(CONNECTIONS_MAX).flat().map(probe => (
      { probe, cause: `more than ${CONNECTIONS_MAX * PROBES_MAX} probes`, hint: "remove others" }));
    this.all.splice(queries.length).forEach(({ scope }) => scope.close());
    while (this.all.length < queries.length) this.add();
    // All are asked again, and none has answered this yet.
    this.all.forEach(part => { part.groups = null; });
    this.all.forEach(({ scope }, number) => scope.ask({ ...query, probes: queries[number] }));
    if (!this.all.length) this.handlers.groups([], []);
  }

  close() {
    this.all.splice(0).forEach(({ scope }) => scope.close());
  }

  add() {
    /** @type {{ scope: Scope, groups: Group[] | null, rejected: Rejected[] }} */
    const part = { scope: new Scope({
      ...this.handlers,
      groups: (groups, rejected) => {
        [part.groups, part.rejected] = [groups, rejected];
        if (this.all.every(it => it.groups))
          this.handlers.groups(this.all.flatMap(it => it.groups ?? []), [...this.all.flatMap(it => it.rejected), ...this.surplus]);
      },
      // Until all have answered, groups have no numbers.
      samples: samples => { if (this.all.every(it => it.groups)) this.handlers.samples({ ...samples, group: this.before(part) + samples.group }); },
      lost: (group, samples) => this.handlers.lost?.(this.before(part) + group, samples),
    }, this.url), groups: null, rejected: [] };
    this.all.push(part);
  }

  /** Groups of the connections before one. @param {{ groups: Group[] | null }} part */
  before(part) {
    const earlier = this.all.slice(0, this.all.indexOf(/** @type {any} */ (part)));
    return earlier.reduce((sum, it) => sum + (it.groups?.length ?? 0), 0);
  }
}
