// The histogram of an expression with the media over it. Each medium is a shape: its peak is dragged
// sideways (centre) and up and down (strength), its shoulders sideways (width). Up is the logarithm
// of the optical depth, as eyes need it; counts are logarithmic too, since halos are faint.

import type { App } from "../app";
import { another, colorFor, given, isShell, shareAt, strengthened, strengthOf, STRONGEST, WEAKEST, widthName } from "../media";
import type { Patch } from "../store";
import { vivid } from "../ui/color";
import { refill, svg } from "../ui/dom";
import { pretty, prettyUnit, ticks, withUnit } from "../ui/format";
import type { Message, Table } from "../wire";

const WIDTH = 320;
const HEIGHT = 150;
const FOOT = 20;
const SIDE = 8;
/** In standard deviations from the centre. */
const TENTH = Math.sqrt(2 * Math.log(10));

/** One thing to take hold of. */
interface Handle {
  x: number;
  y: number;
  label: string;
  text: string;
  value: number;
  /** To other numbers: value along x, log10 of the optical depth. */
  drag(x: number, logTau: number, moving: boolean): void;
  /** Arrow keys: parts of the range. */
  step(right: number, up: number): void;
  round: boolean;
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
    private app: App,
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
    this.app.highlight.ask(x === null || !this.data ? null : { expr: this.data.expr, low, high });
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
    const media: Table[] = this.app.store.document.medium ?? [];
    const expr = this.data?.expr;
    const shapes = media.flatMap((medium, i) => (medium.expr === expr && i !== this.chosen ? [this.shape(medium, i)] : []));
    const own = media[this.chosen];
    refill(this.back, this.grid(), this.bars(), ...shapes, own && own.expr === expr ? this.shape(own, this.chosen) : null);
    const handles = own && own.expr === expr ? this.handles(own, this.chosen) : [];
    // While one is held its element must stay: it has the pointer and the focus.
    if (this.held !== null || this.front.childElementCount === handles.length) handles.forEach((hd, i) => this.place(i, hd));
    else refill(this.front, ...handles.map((hd, i) => this.handle(i, hd)));
    this.current = handles;
    handles.forEach((hd, i) => this.front.children[i]?.classList.toggle("vlm-none", hd.x < 0 || hd.x > WIDTH));
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
      unit && svg("text", { x: 2, y: 10, class: "vlm-axis" }, unit),
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
    const open = this.app.store.open;
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
      const { tau } = shareAt(medium, this.fromX(x), open, i, this.app.stage.tables);
      if (tau > 10 ** WEAKEST) points.push(`${x} ${this.toY(tau).toFixed(1)}`);
    }
    if (!points.length) return svg("g");
    const [first, last] = [points[0], points[points.length - 1]].map((point) => point.split(" ")[0]);
    return svg("path", { ...props, d: `M${first} ${HEIGHT}L${points.join("L")}L${last} ${HEIGHT}` });
  }

  private handles(medium: Table, i: number): Handle[] {
    const open = this.app.store.open;
    const unit = this.data?.unit;
    const at = `medium.${i}.`;
    const [low, high] = this.range;
    const tau = strengthOf(medium);
    const set = (patch: Patch, label: string, moving: boolean) => this.app.store.set(patch, label, moving);
    const strength = (logTau: number) => strengthened(medium, i, 10 ** logTau, this.locked);
    const logTau = Math.log10(Math.max(tau, 1e-4));
    const made: Handle[] = [];
    const add = (name: string, path: string, value: number | null, round: boolean, old: any, toY = this.toY(tau), up = strength) => {
      if (value === null || !Number.isFinite(value)) return;
      const move = (x: number, y: number, moving: boolean) => set([[at + path, another(old, x)], ...up(y)], name, moving);
      made.push({
        x: this.toX(value), y: toY, value, round, label: name,
        text: `${withUnit(value, unit)}, optical depth ${pretty(tau)}`,
        drag: move,
        step: (right, upwards) => move(value + right * (high - low), logTau + upwards * (STRONGEST - WEAKEST), false),
      });
    };
    const center = given(medium, "center", open, i);
    const name = widthName(medium);
    const width = given(medium, name, open, i);
    if (isShell(medium) && center !== null && width !== null) {
      add("centre", "center", center, true, medium.center);
      // Where a Gaussian is a tenth of its peak there is room beside the handle of the peak.
      const [reach, y] = medium.type === "gaussian" ? [TENTH, this.toY(tau / 10)] : [1, 0.5 * (this.toY(tau) + HEIGHT)];
      for (const sign of [-1, 1]) {
        const set_ = (value: number, moving: boolean) => set([[at + name, another(medium[name], Math.max(Math.abs(value), 1e-9 * (high - low)))]], "width", moving);
        made.push({
          x: this.toX(center + sign * reach * width),
          y,
          value: width, round: false, label: sign < 0 ? "width, lower shoulder" : "width, upper shoulder", text: withUnit(width, unit),
          drag: (x, _, moving) => set_((x - center) / reach, moving),
          step: (right) => set_(width + sign * right * (high - low), false),
        });
      }
    }
    const none = (): Patch => [];
    if (medium.type === "isosurface") {
      const list = Array.isArray(medium.level);
      (list ? medium.level : [given(medium, "level", open, i)]).forEach((level: any, k: number) => {
        add("level", list ? `level.${k}` : "level", Number.parseFloat(level), true, list ? level : medium.level);
      });
    }
    if (medium.type === "colormap") {
      add("lower end", "vmin", given(medium, "vmin", open, i), true, medium.vmin);
      add("upper end", "vmax", given(medium, "vmax", open, i), true, medium.vmax);
    }
    if (medium.type === "table") {
      (medium.values ?? []).forEach((value: any, k: number) => {
        const plain = Array.isArray(medium.opacities) && !Array.isArray(medium.opacities[k]);
        const up = plain ? (y: number): Patch => [[`${at}opacities.${k}`, Number((10 ** y).toPrecision(4))]] : none;
        add(`point ${k + 1}`, `values.${k}`, Number.parseFloat(value), true, value, this.toY(plain ? medium.opacities[k] : tau), up);
      });
    }
    return made;
  }

  private handle(i: number, made: Handle): SVGElement {
    const dot = svg("circle", { r: made.round ? 6.5 : 5 });
    const element = svg("g", { class: `vlm-handle${made.round ? "" : " vlm-shoulder"}`, tabindex: "0", role: "slider" }, svg("circle", { r: 11, class: "vlm-grip" }), dot);
    let start = { x: 0, y: 0, dx: 0, dy: 0 };
    const follow = (event: PointerEvent, moving: boolean) => {
      let [x, y] = this.mouse(event);
      [x, y] = [x + start.dx, y + start.dy];
      // Shift: along one axis only.
      if (event.shiftKey && Math.abs(x - start.x) > Math.abs(y - start.y)) y = start.y;
      else if (event.shiftKey) x = start.x;
      this.current[i]?.drag(this.fromX(x), this.fromY(y), moving);
    };
    let moved = false;
    element.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      this.held = i;
      element.focus();
      element.setPointerCapture(event.pointerId);
      const [x, y] = this.mouse(event);
      const { x: hx, y: hy } = this.current[i];
      start = { x: hx, y: hy, dx: hx - x, dy: hy - y };
      moved = false;
    });
    element.addEventListener("pointermove", (event) => {
      if (this.held !== i) return;
      moved = true;
      follow(event, true);
    });
    element.addEventListener("pointerup", (event) => {
      if (this.held !== i) return;
      this.held = null;
      if (moved) follow(event, false);
    });
    element.addEventListener("pointercancel", () => (this.held = null));
    element.addEventListener("dblclick", (event) => event.stopPropagation());
    element.addEventListener("keydown", (event) => {
      const way: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      const [right, up] = way[event.key] ?? [0, 0];
      if (!right && !up) return;
      event.preventDefault();
      const step = event.shiftKey ? 0.1 : 0.01;
      this.current[i]?.step(step * right, step * up);
      this.hover(this.current[i]?.x ?? null);
    });
    element.addEventListener("focus", () => this.held === null && this.hover(this.current[i]?.x ?? null));
    element.addEventListener("blur", () => this.hover(null));
    this.place(i, made, element);
    return element;
  }

  private place(i: number, made: Handle, element = this.front.children[i] as SVGElement): void {
    if (!element) return;
    element.setAttribute("transform", `translate(${made.x.toFixed(1)} ${made.y.toFixed(1)})`);
    element.setAttribute("aria-label", made.label);
    element.setAttribute("aria-valuenow", String(made.value));
    element.setAttribute("aria-valuetext", made.text);
    element.classList.toggle("vlm-shoulder", !made.round);
  }
}
