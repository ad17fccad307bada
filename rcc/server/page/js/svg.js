// Pictures that the server draws: put into the page, fitted and zoomed. It draws nothing itself.

import { button, make } from "./dom.js";

/** Bounds of the zoom, and one step of it. */
const SCALE_MIN = 0.1, SCALE_MAX = 3, STEP = 1.25;

/** A box with a picture and buttons for its size. */
export class Picture {
  constructor() {
    this.view = make("div", undefined, "picture");
    this.view.tabIndex = 0;
    this.bar = make("div", undefined, "row");
    this.bar.append(
      button("fit", () => this.fit()), button("−", () => this.zoom(1 / STEP)), button("+", () => this.zoom(STEP)), button("100 %", () => this.resize(1)));
    /** @type {SVGSVGElement | null} */ this.svg = null;
    /** Pixels. */ this.size = [1, 1];
    this.scale = 1;
    this.isFitted = true;
    this.view.addEventListener("wheel", event => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? STEP : 1 / STEP);
    }, { passive: false });
  }

  /** Shows a picture, at the size of the last one. @param {string} text @param {string} label what it shows, for readers of the screen */
  show(text, label) {
    const parsed = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
    if (parsed.nodeName !== "svg") throw new Error("the picture is no SVG");
    const isFirst = !this.svg;
    const svg = /** @type {SVGSVGElement} */ (/** @type {unknown} */ (document.importNode(parsed, true)));
    this.size = ["width", "height"].map(name => Number(svg.getAttribute(name)) || 100);
    svg.setAttribute("viewBox", "0 0 " + this.size.join(" "));
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", label);
    this.svg = svg;
    const place = [this.view.scrollLeft, this.view.scrollTop];
    this.view.replaceChildren(svg);
    if (isFirst) this.fit(); else this.resize(this.scale);
    [this.view.scrollLeft, this.view.scrollTop] = place;
  }

  /** Makes it as wide as the box, within what is legible. */
  fit() {
    this.resize(Math.min(1, Math.max(0.6, (this.view.clientWidth - 4) / this.size[0])));
  }

  /** @param {number} factor */
  zoom(factor) { this.resize(this.scale * factor); }

  /** @param {number} scale */
  resize(scale) {
    this.scale = Math.min(SCALE_MAX, Math.max(SCALE_MIN, scale));
    if (!this.svg) return;
    this.svg.style.width = this.size[0] * this.scale + "px";
    this.svg.style.height = this.size[1] * this.scale + "px";
  }
}
