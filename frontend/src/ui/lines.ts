// A small plot of curves over one axis, with a cursor that several plots share.

import { h, refill, svg } from "./dom";
import { pretty, ticks } from "./format";

const WIDTH = 320;
const HEIGHT = 64;
const LEFT = 2;

export interface Curve {
  name: string;
  values: number[];
  color: string;
}

const CHANNELS = ["#ff6b6b", "#5bd68a", "#6aa8ff", "#e6c35c", "#c58cff"];

/** A curve for each channel; one if all are the same. */
export function channelCurves(rows: number[][], name: string): Curve[] {
  const grey = rows.every((row) => row.every((v, i) => v === rows[0][i]));
  if (grey) return rows.slice(0, 1).map((values) => ({ name, values, color: "#d5dde6" }));
  return rows.map((values, c) => ({ name: c === 0 ? `${name} 1` : String(c + 1), values, color: CHANNELS[c % CHANNELS.length] }));
}

/** Emission of each channel, and extinction. @param factor of their unit of lengths */
export function coefficientCurves(j: number[][], alpha: number[][], factor: number): Curve[] {
  const curves = [...channelCurves(j, "j"), ...channelCurves(alpha, "α").map((curve) => ({ ...curve, color: "#8d99a6" }))];
  return curves.map((curve) => ({ ...curve, values: curve.values.map((v) => v * factor) }));
}

export class Plot {
  readonly element: HTMLElement;
  private area = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", class: "vlm-lines-plot", "aria-hidden": "true" });
  private cursor = svg("line", { class: "vlm-cursor", y1: 0, y2: HEIGHT });
  private legend = h("div", { class: "vlm-curves" });
  private high = h("span", { class: "vlm-high" });
  private low = h("span", { class: "vlm-low" });
  private x: number[] = [];
  private curves: Curve[] = [];

  constructor(
    private title: string,
    moved: (value: number | null) => void,
  ) {
    this.element = h("figure", { class: "vlm-figure" }, h("figcaption", {}, this.legend), this.area, this.high, this.low);
    const at = (event: PointerEvent) => {
      const box = this.area.getBoundingClientRect();
      const t = (event.clientX - box.left) / box.width;
      moved(this.x.length ? this.x[0] + t * (this.x[this.x.length - 1] - this.x[0]) : null);
    };
    this.area.addEventListener("pointermove", at);
    this.area.addEventListener("pointerleave", () => moved(null));
  }

  show(x: number[], curves: Curve[], unit = "", wide = true): void {
    this.x = x;
    this.curves = curves;
    const all = curves.flatMap((curve) => curve.values).filter(Number.isFinite);
    let [least, most] = [Math.min(...all), Math.max(...all)];
    const positive = all.filter((v) => v > 0);
    const smallest = Math.min(...positive);
    // Along a ray fields change by many powers of ten; then the logarithm is what shows them.
    const log = wide && least >= 0 && positive.length > 0 && most / smallest > 100;
    if (log) least = Math.max(smallest, most * 1e-6);
    else if (least > 0) least = 0;
    const f = log ? (v: number) => Math.log(Math.max(v, least)) : (v: number) => v;
    const toY = (v: number) => HEIGHT - 2 - ((f(v) - f(least)) / (f(most) - f(least) || 1)) * (HEIGHT - 6);
    const toX = (v: number) => LEFT + ((v - x[0]) / (x[x.length - 1] - x[0] || 1)) * (WIDTH - 2 * LEFT);
    const paths = curves.map((curve) => {
      let path = "";
      let down = false;
      curve.values.forEach((v, i) => {
        if (!Number.isFinite(v)) return void (down = false);
        path += `${down ? "L" : "M"}${toX(x[i]).toFixed(1)} ${toY(v).toFixed(1)}`;
        down = true;
      });
      return svg("path", { d: path, stroke: curve.color, class: "vlm-line-of" });
    });
    const grid = ticks(x[0], x[x.length - 1], 4).map((v) => svg("line", { class: "vlm-tick", x1: toX(v), x2: toX(v), y1: 0, y2: HEIGHT }));
    refill(this.area, ...grid, ...paths, this.cursor);
    this.high.textContent = all.length ? pretty(most, 2) + (log ? " log" : "") : "";
    this.low.textContent = all.length ? pretty(least, 2) : "";
    this.unit = unit;
    this.at(null);
  }

  private unit = "";

  /** Put the cursor at a value of the axis, and say what the curves are there. */
  at(value: number | null, where = ""): void {
    const n = this.x.length;
    const hidden = value === null || !n;
    this.cursor.classList.toggle("vlm-none", hidden);
    let i = 0;
    if (!hidden) {
      const t = (value - this.x[0]) / (this.x[n - 1] - this.x[0] || 1);
      const px = LEFT + t * (WIDTH - 2 * LEFT);
      this.cursor.setAttribute("x1", String(px));
      this.cursor.setAttribute("x2", String(px));
      i = this.x.reduce((best, v, k) => (Math.abs(v - value) < Math.abs(this.x[best] - value) ? k : best), 0);
    }
    const entries = this.curves.map((curve) => {
      const entry = h("span", {}, curve.name + (hidden ? "" : ` ${pretty(curve.values[i])}`));
      entry.style.setProperty("--curve", curve.color);
      return entry;
    });
    refill(this.legend, h("strong", {}, where || this.title), ...entries, h("em", {}, this.unit));
  }
}
