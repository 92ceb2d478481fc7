// The histogram of an expression with the media over it. Each medium is a shape: its peak is dragged
// sideways (centre) and up and down (strength), its shoulders sideways (width). Up is the logarithm
// of the optical depth, as eyes need it; counts are logarithmic too, since halos are faint.

import { another, colorFor, given, isShell, shareAt, strengthened, strengthOf, STRONGEST, WEAKEST, widthName } from "../media";
import type { Parts } from "../parts";
import type { Patch } from "../store";
import { vivid } from "../ui/color";
import { ARROWS, refill, svg } from "../ui/dom";
import { numberOf, pretty, prettyUnit, ticks, withUnit } from "../ui/format";
import type { Message, Table } from "../wire";

const WIDTH = 320;
const HEIGHT = 150;
const FOOT = 20;
const SIDE = 8;
/** In standard deviations from the centre. */
const TENTH = Math.sqrt(2 * Math.log(10));

/** One thing to take hold of. */
interface Handle {
  /** Value along x, and place along y. */
  at: number;
  y: number;
  round: boolean;
  label: string;
  text: string;
  value: number;
  /** Name of the change in the history. */
  change: string;
  /** The change that brings it to another value, and log10 of the optical depth. */
  put(x: number, logTau: number): Patch;
}

export class Histogram {
  readonly element = svg("svg", { class: "vlm-histogram", viewBox: `0 0 ${WIDTH} ${HEIGHT + FOOT}`, role: "group" });
  /** Index of the medium that has handles, and whether its glow follows its strength. */
  chosen = 0;
  locked = true;
  data: Message | null = null;
  private domain: [number, number] | null = null;
  private held: number | null = null;
  private back = svg("g");
  private front = svg("g");

  constructor(
    private parts: Pick<Parts, "store" | "stage" | "highlight">,
    private choose: (index: number) => void,
    private hovered: (value: number | null) => void,
    private drawn: () => void,
  ) {
    this.element.append(this.back, this.front);
    this.element.addEventListener("wheel", (event) => this.zoom(event), { passive: false });
    this.element.addEventListener("pointermove", (event) => this.hover(event.buttons ? null : this.mouse(event)[0]));
    this.element.addEventListener("pointerleave", () => this.hover(null));
    this.element.addEventListener("dblclick", () => {
      this.domain = null;
      this.draw();
    });
  }

  /** Tell what is under the pointer, or under the handle that has the focus. */
  private hover(x: number | null): void {
    this.hovered(x === null ? null : this.fromX(x));
    const few = 4;
    const [low, high] = [this.fromX((x ?? 0) - few), this.fromX((x ?? 0) + few)];
    this.parts.highlight.ask(x === null || !this.data ? null : { expr: this.data.expr, low, high });
  }

  show(data: Message | null): void {
    if (data?.expr !== this.data?.expr) this.domain = null;
    this.data = data;
    this.draw();
  }

  /** Smallest and largest value that is shown. */
  get range(): [number, number] {
    if (this.domain) return this.domain;
    const edges: number[] = this.data?.edges ?? [];
    if (edges.length > 1) return [edges[0], edges[edges.length - 1]];
    return [0, 1];
  }

  /** Values from the left edge to the right one, and the same as places: for a plot below. */
  get across(): { values: number[]; places: number[] } {
    const places = [...Array(WIDTH / 2 - 1).keys()].map((k) => 2 * (k + 1));
    return { places, values: places.map((x) => this.fromX(x)) };
  }

  /** A histogram over logarithmic edges is drawn over their logarithms. */
  private get logarithmic(): boolean {
    return Boolean(this.data?.log) && this.range[0] > 0;
  }

  toX(value: number): number {
    const f = this.logarithmic ? Math.log : (v: number) => v;
    const [a, b] = this.range.map(f);
    return SIDE + ((f(value) - a) / (b - a || 1)) * (WIDTH - 2 * SIDE);
  }

  fromX(x: number): number {
    const t = (x - SIDE) / (WIDTH - 2 * SIDE);
    const [a, b] = this.range;
    return this.logarithmic ? a * (b / a) ** t : a + t * (b - a);
  }

  private toY(tau: number): number {
    const t = (Math.log10(Math.max(tau, 1e-30)) - WEAKEST) / (STRONGEST - WEAKEST);
    return HEIGHT - Math.min(Math.max(t, 0), 1) * (HEIGHT - 10);
  }

  private fromY(y: number): number {
    const t = (HEIGHT - y) / (HEIGHT - 10);
    return WEAKEST + Math.min(Math.max(t, 0), 1) * (STRONGEST - WEAKEST);
  }

  private zoom(event: WheelEvent): void {
    event.preventDefault();
    const at = this.fromX(this.mouse(event)[0]);
    const factor = 2 ** Math.max(-1, Math.min(1, event.deltaY / 300));
    const all: number[] = this.data?.edges ?? [0, 1];
    const move = (end: number) => (this.logarithmic ? at * (end / at) ** factor : at + (end - at) * factor);
    const [low, high] = [Math.max(move(this.range[0]), all[0]), Math.min(move(this.range[1]), all[all.length - 1])];
    if (high > low) this.domain = [low, high];
    this.draw();
  }

  private mouse(event: MouseEvent): [number, number] {
    const box = this.element.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * WIDTH, ((event.clientY - box.top) / box.height) * (HEIGHT + FOOT)];
  }

  draw(): void {
    const media: Table[] = this.parts.store.document.medium ?? [];
    const expr = this.data?.expr;
    const shapes = media.flatMap((medium, i) => (medium.expr === expr && i !== this.chosen ? [this.shape(medium, i)] : []));
    const own = media[this.chosen];
    refill(this.back, this.grid(), this.bars(), ...shapes, own && own.expr === expr ? this.shape(own, this.chosen) : null);
    const handles = own && own.expr === expr ? this.handles(own, this.chosen) : [];
    // While one is held its element must stay: it has the pointer and the focus.
    if (this.held !== null || this.front.childElementCount === handles.length) handles.forEach((hd, i) => this.place(i, hd));
    else refill(this.front, ...handles.map((hd, i) => this.handle(i, hd)));
    this.current = handles;
    handles.forEach(({ at }, i) => this.front.children[i]?.classList.toggle("vlm-none", this.toX(at) < 0 || this.toX(at) > WIDTH));
    this.element.setAttribute("aria-label", `Histogram of ${expr ?? "nothing"}`);
    this.drawn();
  }

  private current: Handle[] = [];

  private grid(): SVGElement {
    const [low, high] = this.range;
    const marks = !this.data ? [] : this.logarithmic
      ? [...Array(60).keys()].map((k) => 10 ** (Math.ceil(Math.log10(low)) + k)).filter((v) => v <= high)
      : ticks(low, high, 5);
    const every = Math.ceil(marks.length / 6);
    const unit = prettyUnit(this.data?.unit);
    const level = this.data?.level ?? 0;
    return svg(
      "g",
      { class: "vlm-grid" },
      ...[-2, 0, 2].flatMap((power) => {
        const y = this.toY(10 ** power);
        return [
          svg("line", { x1: 0, x2: WIDTH, y1: y, y2: y }),
          svg("text", { x: WIDTH - 2, y: y - 3, "text-anchor": "end" }, `τ ${pretty(10 ** power)}`),
        ];
      }),
      svg("line", { x1: 0, x2: WIDTH, y1: HEIGHT, y2: HEIGHT, class: "vlm-base" }),
      ...marks.filter((_, i) => i % every === 0).map((v) => {
        const x = Math.min(Math.max(this.toX(v), 16), WIDTH - 16);
        return svg("text", { x, y: HEIGHT + 14, "text-anchor": "middle" }, pretty(v));
      }),
      (unit || level) && svg("text", { x: 2, y: 10, class: "vlm-axis" }, `${unit}${level ? ` (level ${level} of the file)` : ""}`),
    );
  }

  private bars(): SVGElement {
    const counts: number[] = this.data?.counts ?? [];
    const edges: number[] = this.data?.edges ?? [];
    const most = Math.log1p(Math.max(...counts, 1));
    let path = `M${this.toX(edges[0] ?? 0)} ${HEIGHT}`;
    counts.forEach((count, i) => {
      const y = HEIGHT - (Math.log1p(count) / most) * (HEIGHT - 24);
      path += `L${this.toX(edges[i]).toFixed(1)} ${y.toFixed(1)}L${this.toX(edges[i + 1]).toFixed(1)} ${y.toFixed(1)}`;
    });
    return svg("path", { class: "vlm-bars", d: counts.length ? `${path}V${HEIGHT}Z` : "" });
  }

  private shape(medium: Table, i: number): SVGElement {
    const open = this.parts.store.open;
    const color = medium.type === "colormap" ? "#9aa7b5" : vivid(colorFor(medium));
    const props = {
      class: `vlm-shape${i === this.chosen ? " vlm-chosen" : ""}${medium.hidden ? " vlm-off" : ""}`,
      fill: color, stroke: color, onpointerdown: () => this.choose(i),
    };
    if (medium.type === "isosurface") {
      const x = this.toX(given(medium, "level", open, i) ?? NaN);
      return Number.isFinite(x) ? svg("path", { ...props, d: `M${x} ${HEIGHT}V${this.toY(strengthOf(medium))}` }) : svg("g");
    }
    // Only where it is above the lowest strength of the axis: no line along the bottom.
    const points: string[] = [];
    for (let x = SIDE; x <= WIDTH - SIDE; x += 1) {
      const { tau } = shareAt(medium, this.fromX(x), open, i, this.parts.stage.tables);
      if (tau > 10 ** WEAKEST) points.push(`${x} ${this.toY(tau).toFixed(1)}`);
    }
    if (!points.length) return svg("g");
    const [first, last] = [points[0], points[points.length - 1]].map((point) => point.split(" ")[0]);
    return svg("path", { ...props, d: `M${first} ${HEIGHT}L${points.join("L")}L${last} ${HEIGHT}` });
  }

  private handles(medium: Table, i: number): Handle[] {
    const path = `medium.${i}.`;
    const tau = strengthOf(medium);
    const number = (name: string) => given(medium, name, this.parts.store.open, i);
    const text = (value: number) => withUnit(value, this.data?.unit);
    const made: Handle[] = [];
    const point = (label: string, name: string, old: any, value: number | null, y = tau, up = (logTau: number) => strengthened(medium, i, 10 ** logTau, this.locked)) => {
      if (value === null || !Number.isFinite(value)) return;
      const put = (x: number, logTau: number): Patch => [[path + name, another(old, x)], ...up(logTau)];
      made.push({ at: value, y: this.toY(y), round: true, label, change: label, value, text: `${text(value)}, optical depth ${pretty(tau)}`, put });
    };
    const [center, name] = [number("center"), widthName(medium)];
    const width = number(name);
    if (isShell(medium) && center !== null && width !== null) {
      point("centre", "center", medium.center, center);
      // Where a Gaussian is a tenth of its peak there is room beside the handle of the peak.
      const [reach, y] = medium.type === "gaussian" ? [TENTH, this.toY(tau / 10)] : [1, 0.5 * (this.toY(tau) + HEIGHT)];
      const least = 1e-9 * (this.range[1] - this.range[0]);
      const put = (x: number): Patch => [[path + name, another(medium[name], Math.max(Math.abs(x - center) / reach, least))]];
      for (const [sign, side] of [[-1, "lower"], [1, "upper"]] as const) {
        made.push({ at: center + sign * reach * width, y, round: false, label: `width, ${side} shoulder`, change: "width", value: width, text: text(width), put });
      }
    }
    if (medium.type === "isosurface") {
      const { level } = medium;
      [level].flat().forEach((one, k) => point("level", Array.isArray(level) ? `level.${k}` : "level", one, numberOf(one) ?? number("level")));
    }
    if (medium.type === "colormap") {
      point("lower end", "vmin", medium.vmin, number("vmin"));
      point("upper end", "vmax", medium.vmax, number("vmax"));
    }
    if (medium.type === "table") {
      (medium.values ?? []).forEach((value: any, k: number) => {
        const plain = Array.isArray(medium.opacities) && !Array.isArray(medium.opacities[k]);
        const up = (logTau: number): Patch => (plain ? [[`${path}opacities.${k}`, Number((10 ** logTau).toPrecision(4))]] : []);
        point(`point ${k + 1}`, `values.${k}`, value, numberOf(value), plain ? medium.opacities[k] : tau, up);
      });
    }
    return made.filter(({ at }) => Number.isFinite(this.toX(at)));
  }

  private handle(i: number, made: Handle): SVGElement {
    const dot = svg("circle", { r: made.round ? 6.5 : 5 });
    const element = svg("g", { class: "vlm-handle", tabindex: "0", role: "slider" }, svg("circle", { r: 11, class: "vlm-grip" }), dot);
    const drag = (x: number, logTau: number, moving: boolean) => this.parts.store.set(this.current[i].put(x, logTau), this.current[i].change, moving);
    const tell = () => this.current[i] && this.hover(this.toX(this.current[i].at));
    let start = { x: 0, y: 0, dx: 0, dy: 0 };
    let moved = false;
    const follow = (event: PointerEvent) => {
      if (this.held !== i) return;
      const moving = event.type === "pointermove";
      if (!moving) this.held = null;
      moved ||= moving;
      if (!moved) return;
      let [x, y] = this.mouse(event);
      [x, y] = [x + start.dx, y + start.dy];
      // Shift: along one axis only.
      if (event.shiftKey && Math.abs(x - start.x) > Math.abs(y - start.y)) y = start.y;
      else if (event.shiftKey) x = start.x;
      drag(this.fromX(x), this.fromY(y), moving);
    };
    const take = (event: PointerEvent) => {
      event.preventDefault();
      this.held = i;
      moved = false;
      element.focus();
      element.setPointerCapture(event.pointerId);
      const [x, y] = this.mouse(event);
      const { at, y: hy } = this.current[i];
      start = { x: this.toX(at), y: hy, dx: this.toX(at) - x, dy: hy - y };
    };
    const step = (event: KeyboardEvent) => {
      const way = ARROWS[event.key];
      if (!way) return;
      event.preventDefault();
      const [part, [low, high]] = [event.shiftKey ? 0.1 : 0.01, this.range];
      const { at, y } = this.current[i];
      drag(at + part * way[0] * (high - low), this.fromY(y) + part * way[1] * (STRONGEST - WEAKEST), false);
      tell();
    };
    const listeners: Record<string, (event: any) => void> = {
      pointerdown: take, pointermove: follow, pointerup: follow, pointercancel: () => (this.held = null), keydown: step,
      focus: () => this.held === null && tell(), blur: () => this.hover(null), dblclick: (event) => event.stopPropagation(),
    };
    for (const [name, listener] of Object.entries(listeners)) element.addEventListener(name, listener);
    this.place(i, made, element);
    return element;
  }

  private place(i: number, made: Handle, element = this.front.children[i] as SVGElement): void {
    if (!element) return;
    element.setAttribute("transform", `translate(${this.toX(made.at).toFixed(1)} ${made.y.toFixed(1)})`);
    element.setAttribute("aria-label", made.label);
    element.setAttribute("aria-valuenow", String(made.value));
    element.setAttribute("aria-valuetext", made.text);
    element.classList.toggle("vlm-shoulder", !made.round);
  }
}
