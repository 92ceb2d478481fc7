// Lines above the picture: the domain's box, the pivot, the probed point, a scale bar, and the axes
// in a corner, which can be clicked. All with the camera of the frame that is shown.

import { axesOf } from "./camera";
import { letterOf, lettersOf, NAMES } from "./orientation";
import type { Stage } from "./stage";
import { h, refill, svg } from "./ui/dom";
import { lengthsShownIn, roundLength } from "./ui/format";
import { times } from "./vec";
import type { Vec3, VolumeInfo } from "./wire";

const GIZMO = 92;
const ARM = 30;

export class Overlay {
  readonly lines = svg("svg", { class: "vlm-lines", "aria-hidden": "true" });
  readonly gizmo = svg("svg", {
    class: "vlm-gizmo",
    viewBox: `${-GIZMO / 2} ${-GIZMO / 2} ${GIZMO} ${GIZMO}`,
    role: "group",
    "aria-label": "Look along an axis",
  });
  readonly bar = h("div", { class: "vlm-scalebar" });
  pivot: Vec3 | null = null;
  probed: Vec3 | null = null;
  shown = true;
  /** What panels draw above the picture, and what it depends on besides the view. */
  readonly layers: { key(): unknown; draw(): SVGElement[] }[] = [];
  private named = "";
  private ends = new Map<string, SVGGElement>();
  private stalks = new Map<string, SVGLineElement>();
  private order = "";
  private key = "";
  private upper = 0;

  constructor(
    private stage: Stage,
    private side: (axis: string) => void,
  ) {
    for (const axis of ["x", "y", "z", "X", "Y", "Z"]) this.addEnd(axis);
  }

  private addEnd(axis: string): void {
    const positive = axis === axis.toLowerCase();
    const name = `${positive ? "+" : "−"}${axis.toLowerCase()}`;
    const act = (event: Event) => {
      if (event instanceof KeyboardEvent && event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      this.side(axis);
    };
    const end = svg(
      "g",
      { class: `vlm-end vlm-${axis.toLowerCase()}`, tabindex: "0", role: "button", "aria-label": `Look from ${name}`, onclick: act, onkeydown: act },
      svg("title", {}, `Look from ${name}  (${axis})`),
      svg("circle", { r: positive ? 9 : 5, class: positive ? "vlm-plus" : "vlm-minus" }),
      svg("text", { "text-anchor": "middle", dy: "0.34em" }, positive && axis),
    );
    this.ends.set(axis, end);
    if (positive) this.stalks.set(axis, svg("line", { class: `vlm-stalk vlm-${axis}` }));
  }

  draw(info: VolumeInfo): void {
    const { canvas, frameView } = this.stage;
    if (!frameView) return;
    // Lines over the whole picture are dear to draw: not anew for another exposure.
    const size = [canvas.clientWidth, canvas.clientHeight];
    // Letters are below the buttons, which are at the upper border.
    const { offsetTop: top, offsetHeight: height } = this.lines.nextElementSibling as HTMLElement;
    this.upper = Math.min(top + height, 0.4 * size[1]);
    const key = JSON.stringify([frameView, this.stage.view, size, this.upper, info.bounds, this.pivot, this.probed, this.shown, this.layers.map((one) => one.key()), lengthsShownIn(info.unit)]);
    if (key === this.key) return;
    this.key = key;
    this.lines.setAttribute("viewBox", `0 0 ${canvas.clientWidth} ${canvas.clientHeight}`);
    const parts: SVGElement[] = [];
    const { isFlat } = this.stage;
    this.bar.hidden = !isFlat;
    this.gizmo.classList.toggle("vlm-none", !isFlat);
    if (!isFlat) return refill(this.lines);
    if (this.shown) parts.push(...this.box(info));
    parts.push(...this.layers.flatMap((one) => one.draw()));
    if (this.pivot) parts.push(this.mark(this.pivot, "vlm-pivot"));
    if (this.probed) parts.push(this.mark(this.probed, "vlm-probed"));
    parts.push(...this.letters(info));
    refill(this.lines, ...parts);
    this.nameEnds(info);
    this.drawGizmo();
    this.drawBar(info);
  }

  /** Twelve edges; the three that meet at the farthest corner are behind everything. */
  private box(info: VolumeInfo): SVGElement[] {
    const corners = [...Array(8).keys()].map((i) => {
      const at = info.bounds.map((b, k) => b[(i >> k) & 1]) as Vec3;
      return this.stage.toPixels(at);
    });
    const farthest = corners.reduce((best, c, i) => (c.depth > corners[best].depth ? i : best), 0);
    let front = "";
    let behind = "";
    for (let i = 0; i < 8; i++) {
      for (const bit of [1, 2, 4]) {
        if (i & bit) continue;
        const j = i | bit;
        const [a, b] = [corners[i], corners[j]];
        // What is behind an observer inside has no place in the picture.
        if (this.stage.frameView!.type === "perspective" && (a.depth <= 0 || b.depth <= 0)) continue;
        const line = `M${a.x.toFixed(1)} ${a.y.toFixed(1)}L${b.x.toFixed(1)} ${b.y.toFixed(1)}`;
        if (i === farthest || j === farthest) behind += line;
        else front += line;
      }
    }
    return [svg("path", { d: behind, class: "vlm-behind" }), svg("path", { d: front, class: "vlm-front" })];
  }

  /** The sides of the patient, in the middle of the borders. */
  private letters(info: VolumeInfo): SVGElement[] {
    const [right, up] = axesOf(this.stage.frameView!);
    const { clientWidth: w, clientHeight: h_ } = this.stage.canvas;
    const places: [Vec3, number, number][] = [
      [right, w - 18, h_ / 2], [times(right, -1), 18, h_ / 2], [up, w / 2, this.upper + 16], [times(up, -1), w / 2, h_ - 20],
    ];
    return places.map(([way, x, y]) => svg("text", { class: "vlm-letter", x, y }, lettersOf(info, way)));
  }

  /** Both ends of each axis carry the patient's side, where that is known. */
  private nameEnds(info: VolumeInfo): void {
    const letters = [...this.ends.keys()].map((axis) => letterOf(info, axis));
    if (letters.join() === this.named) return;
    this.named = letters.join();
    [...this.ends].forEach(([axis, end], i) => {
      const letter = letters[i];
      const positive = axis === axis.toLowerCase();
      end.querySelector("text")!.textContent = letter || (positive ? axis : "");
      end.querySelector("circle")!.setAttribute("r", positive || letter ? "9" : "5");
      if (!letter) return;
      end.setAttribute("aria-label", `Look from ${NAMES[letter]}`);
      end.querySelector("title")!.textContent = `Look from ${NAMES[letter]}  (${letter})`;
    });
  }

  private mark(point: Vec3, name: string): SVGElement {
    const { x, y } = this.stage.toPixels(point);
    return svg(
      "g",
      { class: name, transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})` },
      svg("circle", { r: 6 }),
      svg("path", { d: "M-11 0h6M5 0h6M0-11v6M0 5v6" }),
    );
  }

  private drawGizmo(): void {
    const axes = axesOf(this.stage.frameView!);
    const ends = [...this.ends].map(([axis, end]) => {
      const k = "xyz".indexOf(axis.toLowerCase());
      const sign = axis === axis.toLowerCase() ? 1 : -1;
      const [x, y, depth] = [0, 1, 2].map((i) => sign * axes[i][k]);
      end.setAttribute("transform", `translate(${(x * ARM).toFixed(1)} ${(-y * ARM).toFixed(1)})`);
      const stalk = this.stalks.get(axis);
      stalk?.setAttribute("x2", (x * ARM).toFixed(1));
      stalk?.setAttribute("y2", (-y * ARM).toFixed(1));
      return { depth, end, stalk };
    });
    ends.sort((a, b) => a.depth - b.depth);
    // Elements are moved only when their order changes, so that the focus is not lost.
    const order = ends.map((e) => e.end.getAttribute("aria-label")).join();
    if (order === this.order) return;
    this.order = order;
    const focused = this.gizmo.querySelector<SVGGElement>(":focus");
    refill(this.gizmo, ...ends.flatMap((e) => [e.stalk ?? null, e.end]));
    focused?.focus();
  }

  private drawBar(info: VolumeInfo): void {
    const { pixel, canvas, frameView } = this.stage;
    const { length, text } = roundLength(pixel * Math.min(0.28 * canvas.clientWidth, 180), info.unit);
    const width = length / pixel;
    if (!(width > 0)) return;
    const about = frameView!.type === "perspective" ? "at the focus" : null;
    refill(
      this.bar,
      h("span", {}, about ? `${text} ${about}` : text),
      svg("svg", { width: width.toFixed(1), height: 7 }, svg("path", { d: `M.5 0v6.500H${(width - 0.5).toFixed(1)}V0` })),
    );
  }
}
