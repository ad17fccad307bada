// The rules between nets as a graph: nets, the rules that watch them, and what these start, cancel and stop. It requests nothing.

import { list, make } from "./dom.js";

/** @typedef {import("./dom.js").Json} Json */
/** A net or a rule in the picture. @typedef {{ key: string, kind: "net" | "rule", name: string, word: string, title: string, layer: number, x: number, y: number }} Node */
/** @typedef {{ from: Node, to: Node, kind: "if" | "start" | "cancel" | "stop" }} Edge */

const NS = "http://www.w3.org/2000/svg";
/** Size of a box, and the space between two, pixels. */
const WIDTH = 168, HEIGHT = 40, GAP_X = 64, GAP_Y = 16, MARGIN = 8;
/** Rules that are drawn: pending ones first, then the latest; more are in the table. */
export const RULES_MAX = 40;
/** Letters of a condition, and of a net's description. */
const LETTERS_MAX = 24;
/** Names of nets in a condition. */
const NET = /\brpinet\d+\b/g;

/** @param {string} text */
const short = text => text.length > LETTERS_MAX ? text.slice(0, LETTERS_MAX - 1) + "…" : text;

/** Nets and rules as boxes in columns: a rule is behind the nets that its condition names, the nets that it starts behind the rule. What it
 * cancels or stops may be anywhere.
 * @param {Json[]} rules as `/rules/` lists them @param {Map<string, { status: string, desc: string }>} nets
 * @returns {{ nodes: Node[], edges: Edge[], width: number, height: number, leftOut: number }} */
export function layout(rules, nets) {
  const isPending = (/** @type {Json} */ rule) => rule.state === "ACTIVE";
  const latest = rules.slice().reverse(), chosen = [...latest.filter(isPending), ...latest.filter(rule => !isPending(rule))].slice(0, RULES_MAX);
  // In the order in which they were made, so that the picture does not jump when one is decided.
  const drawn = rules.filter(rule => chosen.includes(rule));
  /** @type {Map<string, Node>} */
  const nodes = new Map();
  /** @type {Edge[]} */
  const edges = [];
  const net = (/** @type {string} */ name) => {
    const known = nodes.get(name);
    if (known) return known;
    const { status, desc } = nets.get(name) ?? { status: "unloaded", desc: "" };
    /** @type {Node} */
    const node = { key: name, kind: "net", name: short(desc ? name + " " + desc : name), word: status, title: desc, layer: 0, x: 0, y: 0 };
    nodes.set(name, node);
    return node;
  };
  for (const rule of drawn) {
    const condition = String(rule.condition);
    const watched = [...new Set(condition.match(NET) ?? [])].map(net);
    /** @type {Node} */
    const node = { key: "rule " + rule.id, kind: "rule", name: short(condition), word: String(rule.state), layer: 0, x: 0, y: 0,
      title: [condition, rule.desc, rule.why].filter(Boolean).join("\n") };
    nodes.set(node.key, node);
    edges.push(...watched.map(from => /** @type {Edge} */ ({ from, to: node, kind: "if" })));
    for (const kind of /** @type {const} */ (["start", "cancel", "stop"]))
      edges.push(...list(rule, kind).map(it => ({ from: node, to: net(String(it.net)), kind })));
  }
  // The longest way by conditions and starts; rules that start each other in a circle end it by the bound.
  const forward = edges.filter(edge => edge.kind === "if" || edge.kind === "start"), bound = 2 * drawn.length + 1;
  for (let round = 0, hasChanged = true; hasChanged && round < bound; round++) {
    hasChanged = false;
    for (const { from, to } of forward)
      if (to.layer <= from.layer && from.layer + 1 < bound) { to.layer = from.layer + 1; hasChanged = true; }
  }
  const layers = [...new Set([...nodes.values()].map(node => node.layer))].sort((a, b) => a - b);
  /** @type {number[]} */
  const filled = layers.map(() => 0);
  for (const node of nodes.values()) {
    node.layer = layers.indexOf(node.layer);
    node.x = MARGIN + node.layer * (WIDTH + GAP_X);
    node.y = MARGIN + filled[node.layer]++ * (HEIGHT + GAP_Y);
  }
  return { nodes: [...nodes.values()], edges, leftOut: rules.length - drawn.length,
    width: 2 * MARGIN + Math.max(1, layers.length) * (WIDTH + GAP_X) - GAP_X, height: 2 * MARGIN + Math.max(1, ...filled) * (HEIGHT + GAP_Y) - GAP_Y };
}

/** @param {string} tag @param {Record<string, string | number>} attributes @param {...(Node | SVGElement | string)} children */
function shape(tag, attributes, ...children) {
  const element = /** @type {SVGElement} */ (document.createElementNS(NS, tag));
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(.../** @type {(Element | string)[]} */ (children));
  return element;
}

/** The line of an edge: from side to side, or around below if it goes back. @param {Edge} edge @param {number} height of the picture */
export function path({ from, to }, height) {
  const [y, ty] = [from.y + HEIGHT / 2, to.y + HEIGHT / 2];
  if (to.layer > from.layer) {
    const [x, tx] = [from.x + WIDTH, to.x - 5], middle = (x + tx) / 2;
    return `M${x} ${y}C${middle} ${y} ${middle} ${ty} ${tx} ${ty}`;
  }
  // Below both boxes, and into the lower edge.
  const low = Math.min(height - 1, Math.max(from.y, to.y) + HEIGHT + GAP_Y), [x, tx] = [from.x + WIDTH / 2, to.x + WIDTH / 2 + 14];
  return `M${x} ${from.y + HEIGHT}C${x} ${low} ${tx} ${low} ${tx} ${to.y + HEIGHT + 5}`;
}

/** The picture of rules. @param {Json[]} rules @param {Map<string, { status: string, desc: string }>} nets */
export function drawRules(rules, nets) {
  const { nodes, edges, width, height, leftOut } = layout(rules, nets), tall = height + GAP_Y;
  const svg = shape("svg", { width, height: tall, viewBox: "0 0 " + width + " " + tall, class: "rules", role: "img", "aria-label": "Rules between nets" });
  for (const kind of ["if", "start", "cancel", "stop"])
    svg.append(shape("marker", { id: "rule-" + kind, class: kind, viewBox: "0 0 6 6", refX: 1, refY: 3, markerWidth: 6, markerHeight: 6, orient: "auto" },
      shape("path", { d: "M0 0L6 3L0 6z" })));
  for (const edge of edges) svg.append(shape("path", { d: path(edge, tall), class: "edge " + edge.kind, "marker-end": "url(#rule-" + edge.kind + ")" }));
  for (const node of nodes) {
    const { x, y, kind, word } = node;
    const group = shape("g", { class: kind + " " + word },
      shape("title", {}, [node.kind === "net" ? node.key + " " + word : word, node.title].filter(Boolean).join("\n")),
      shape("rect", { x, y, width: WIDTH, height: HEIGHT, rx: kind === "net" ? 4 : HEIGHT / 2 }),
      shape("text", { x: x + (kind === "net" ? 8 : 18), y: y + 17, class: "name" }, node.name),
      shape("text", { x: x + (kind === "net" ? 8 : 18), y: y + 32 }, word));
    svg.append(kind === "net" && nets.has(node.key) ? shape("a", { href: "#nets/" + node.key }, group) : group);
  }
  const box = make("div", undefined, "picture"), words = make("p", undefined, "dim legend");
  box.append(svg);
  for (const [kind, text] of [["if", "condition"], ["start", "starts"], ["cancel", "cancels"], ["stop", "stops"]]) {
    const sample = make("span");
    sample.append(make("i", undefined, kind), " " + text);
    words.append(sample);
  }
  if (leftOut) words.append(leftOut + " older rules are in the table only");
  return [words, box];
}
