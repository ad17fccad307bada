// Client of `/scope`: asks for probes and receives their samples. It keeps none of them.

/** @typedef {{ thread: string, period_s: number, probes: { name: string, unit: string }[] }} Group probes that are sampled together */
/** Rows of samples: a time each, s since the controller's start, and a value of each probe of the group, NaN for null.
 * @typedef {{ group: number, rows: number, columns: number, lost: number, data: Float64Array }} Samples */
/** When a capture begins. @typedef {{ on: string, probe?: string, level?: number, low?: number, high?: number, equals?: string }} Trigger */
/** @typedef {{ probes: string[], every?: number, trigger?: Trigger | null, pre_s?: number, post_s?: number, mode?: "auto" | "normal" | "single",
 *   rate_hz?: number }} Query */
/** @typedef {{ probe: string, cause: string, hint?: string }} Rejected */
/**
 * @typedef {Object} Handlers
 * @property {(groups: Group[], rejected: Rejected[]) => void} groups what is sampled from now on
 * @property {(samples: Samples) => void} samples
 * @property {(time_s: number, cause: string) => void} [triggered] a whole capture follows
 * @property {(probe: string, cause: string) => void} [ended] a probe does not exist any more
 * @property {(group: number, samples: number) => void} [lost]
 * @property {(text: string, isGood: boolean) => void} state whether there is a connection, and why not
 */

/** Most probes of one connection. */
export const PROBES_MAX = 64;
/** Version of the protocol. */
const VERSION = 1;
/** Bytes before the rows of a message. */
const HEAD = 16;
/** Time until a lost connection is tried again, ms: first and longest. */
const RETRY_MS = [500, 5000];

/** Reads a binary message. @param {ArrayBuffer} bytes @returns {Samples} */
export function readSamples(bytes) {
  if (bytes.byteLength < HEAD) throw new Error("a message of " + bytes.byteLength + " bytes is shorter than its head");
  const view = new DataView(bytes), [group, rows, columns, lost] = [0, 4, 8, 12].map(at => view.getUint32(at, true));
  const count = rows * (columns + 1);
  if (bytes.byteLength !== HEAD + 8 * count)
    throw new Error("a message of " + bytes.byteLength + " bytes has " + rows + " rows of " + columns + " probes in its head");
  // Numbers of the wire are those of every processor that runs a browser; others read them one by one.
  const isLittle = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;
  const data = isLittle ? new Float64Array(bytes, HEAD, count) : Float64Array.from({ length: count }, (_, i) => view.getFloat64(HEAD + 8 * i, true));
  return { group, rows, columns, lost, data };
}

/** The address of the scope of the server of this page. @param {{ protocol: string, host: string }} at */
export const scopeUrl = at => (at.protocol === "https:" ? "wss://" : "ws://") + at.host + "/scope";

export class Scope {
  /** @param {Handlers} handlers @param {string} [url] */
  constructor(handlers, url = scopeUrl(location)) {
    this.handlers = handlers;
    this.url = url;
    /** @type {Query | null} */ this.query = null;
    /** @type {WebSocket | null} */ this.socket = null;
    /** @type {Group[]} */ this.groups = [];
    this.retry_ms = RETRY_MS[0];
    this.isOver = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */ this.timer = undefined;
  }

  /** Asks for these probes instead of all before. None ends the connection. @param {Query} query */
  ask(query) {
    this.query = query;
    if (!query.probes.length) { this.disconnect(); this.handlers.groups([], []); }
    else if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(query));
    else if (!this.socket) this.connect();
  }

  /** Ends it. */
  close() {
    this.isOver = true;
    this.disconnect();
  }

  disconnect() {
    clearTimeout(this.timer);
    const socket = this.socket;
    this.socket = null;
    this.groups = [];
    socket?.close();
  }

  connect() {
    if (this.isOver) return;
    const socket = new WebSocket(this.url);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.retry_ms = RETRY_MS[0];
      if (this.query) socket.send(JSON.stringify(this.query));
    };
    // What an earlier connection still delivers belongs to an earlier request.
    socket.onmessage = event => { if (socket === this.socket) this.receive(event.data); };
    socket.onclose = event => {
      if (socket !== this.socket) return;
      this.disconnect();
      const why = event.reason || "no connection to the scope";
      this.handlers.state(why + "; the next attempt follows", false);
      this.timer = setTimeout(() => this.connect(), this.retry_ms);
      this.retry_ms = Math.min(RETRY_MS[1], 2 * this.retry_ms);
    };
  }

  /** @param {string | ArrayBuffer} data */
  receive(data) {
    try {
      if (typeof data === "string") this.handle(JSON.parse(data));
      else this.deliver(readSamples(data));
    } catch (error) {
      this.handlers.state("scope: " + (error instanceof Error ? error.message : error), false);
    }
  }

  /** @param {Samples} samples */
  deliver(samples) {
    const group = this.groups[samples.group];
    if (!group || group.probes.length !== samples.columns)
      throw new Error("samples of " + samples.columns + " probes of group " + samples.group + ", which was not announced");
    this.handlers.samples(samples);
  }

  /** The whole request was refused: so was each of its probes. @param {string} cause @param {string} [hint] */
  refuse(cause, hint) {
    this.groups = [];
    this.handlers.state(cause, false);
    this.handlers.groups([], (this.query?.probes ?? []).map(probe => ({ probe, cause, hint })));
  }

  /** @param {any} message */
  handle(message) {
    const { scope, triggered, ended, lost, done, error } = message;
    if (scope) {
      if (scope.version !== VERSION) throw new Error("the controller has version " + scope.version + "; this page reads " + VERSION + ": reload it");
      this.groups = scope.groups;
      this.handlers.state("live", true);
      this.handlers.groups(scope.groups, scope.rejected ?? []);
    } else if (triggered) this.handlers.triggered?.(triggered.time_s, triggered.cause);
    else if (ended) this.handlers.ended?.(ended.probe, ended.cause);
    else if (lost) this.handlers.lost?.(lost.group, lost.samples);
    else if (done) this.handlers.state(done.cause, true);
    else if (error) this.refuse(String(error.cause), error.hint);
  }
}
