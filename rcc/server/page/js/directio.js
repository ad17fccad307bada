// A DirectIO connection of the page: commands with their replies. What it opened ends with it: its session is one that ends when its
// connection is lost.

/** After this time without a reply a command has failed, ms. */
const TIMEOUT_MS = 5000;

/** The texts in a reply, such as `ok("s1")`. @param {string} inside */
export function texts(inside) {
  return [...inside.matchAll(/"((?:[^"\\]|\\.)*)"/gs)].map(([, text]) => text.replace(/\\(.)/gs, "$1"));
}

/** A text as an argument. @param {string} text */
export const quoted = text => '"' + text.replace(/[\\"]/g, "\\$&") + '"';

export class DirectIo {
  constructor() {
    /** @type {WebSocket | null} */ this.socket = null;
    /** @type {Map<string, { good: (values: string[]) => void, bad: (error: Error) => void }>} */ this.waiting = new Map();
    this.tags = 0;
    /** Called once when the connection ends. @type {(why: string) => void} */ this.onEnd = () => {};
  }

  /** Connects and shakes hands. @param {string} [url] */
  async open(url = (location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/DirectIO/") {
    const socket = this.socket = new WebSocket(url);
    socket.onmessage = event => this.receive(String(event.data));
    await new Promise((good, bad) => {
      socket.onopen = () => good(undefined);
      socket.onerror = socket.onclose = () => bad(new Error("the controller does not accept a connection"));
    });
    socket.onerror = null;
    socket.onclose = () => this.end("the connection is lost");
    await this.call("ver", quoted("2.0"));
  }

  /** Sends a command; the texts of its reply. @param {string} command @param {...string} args as they are sent @returns {Promise<string[]>} */
  call(command, ...args) {
    const { socket } = this;
    if (socket?.readyState !== WebSocket.OPEN) return Promise.reject(new Error("there is no connection"));
    const tag = "p" + ++this.tags;
    return new Promise((good, bad) => {
      const timer = setTimeout(() => { this.waiting.delete(tag); bad(new Error(command + " was not answered")); }, TIMEOUT_MS);
      this.waiting.set(tag, {
        good: values => { clearTimeout(timer); good(values); },
        bad: error => { clearTimeout(timer); bad(error); },
      });
      socket.send(tag + "=" + command + "(" + args.join(",") + ")");
    });
  }

  /** @param {string} line */
  receive(line) {
    const found = /^(\w+)=(\w+)\((.*)\)\s*$/s.exec(line);
    if (!found) return;
    const [, tag, kind, inside] = found, waits = this.waiting.get(tag);
    if (!waits || (kind !== "ok" && kind !== "err")) return;
    this.waiting.delete(tag);
    if (kind === "ok") waits.good(texts(inside));
    else waits.bad(new Error(texts(inside).join(": ") || "the command was rejected"));
  }

  /** @param {string} why */
  end(why) {
    if (!this.socket) return;
    this.socket.onclose = null;
    this.socket.close();
    this.socket = null;
    this.waiting.forEach(({ bad }) => bad(new Error(why)));
    this.waiting.clear();
    this.onEnd(why);
  }
}
