// Colour bars in the picture: of the colormap if one is shown, else of each expression that media
// show, with their colours where they are.

import { given, isShell, shareAt, strengthOf, widthName } from "./media";
import type { Server } from "./server";
import type { Stage } from "./stage";
import type { Store } from "./store";
import { valueAt } from "./tone";
import { colorOf, gradient, toHex } from "./ui/color";
import { h, refill } from "./ui/dom";
import { pretty, prettyUnit } from "./ui/format";
import type { Table } from "./wire";

/** Projections in words. */
export const MODES: Record<string, string> = { max: "maximum", mean: "mean", min: "minimum" };
const WIDTH = 180;
const MOST = 3;
const MOST_NAMES = 8;

export class Legend {
  readonly element = h("div", { class: "vlm-legend", "aria-label": "colour bars" });
  private key = "";

  constructor(
    private stage: Stage,
    private store: Store,
    private server: Server,
  ) {}

  /** After each drawing: the limits of a colormap may come with the frame. */
  draw(): void {
    const { tone } = this.stage;
    const media: Table[] = this.store.document.medium ?? [];
    const key = JSON.stringify([tone?.colormap && tone, tone?.colormap ? this.caption() : media, this.store.open]);
    if (key === this.key) return;
    this.key = key;
    if (tone?.colormap) {
      const bar = h("span", { class: "vlm-colorbar" });
      bar.style.background = gradient(this.stage.tables.get(tone.colormap));
      const marks = [0, 0.5, 1].map((w) => h("span", {}, pretty(valueAt(w, tone))));
      return refill(this.element, h("figure", {}, h("figcaption", {}, this.caption()), bar, h("div", { class: "vlm-marks" }, ...marks)));
    }
    const shown = media.map((medium, i) => ({ medium, i })).filter(({ medium }) => !medium.hidden && medium.expr);
    const exprs = [...new Set(shown.map(({ medium }) => medium.expr as string))].slice(0, MOST);
    const tables = shown.filter(({ medium }) => medium.type === "labels").map(({ medium }) => this.names(medium));
    const bars = exprs.filter((expr) => shown.some(({ medium }) => medium.expr === expr && medium.type !== "labels"));
    refill(this.element, ...tables, ...bars.map((expr) => this.bar(expr, shown.filter(({ medium }) => medium.expr === expr))));
  }

  /** Visible labels with their colours, as far as there is room. */
  private names({ expr, labels, colors, visible }: Table): HTMLElement {
    const seen = labels.map((_: string, k: number) => k).filter((k: number) => visible[k]);
    const rows = seen.slice(0, MOST_NAMES).map((k: number) => {
      const swatch = h("span", { class: "vlm-swatch" });
      swatch.style.background = toHex(colorOf(colors[k]));
      return h("li", {}, swatch, labels[k]);
    });
    return h("figure", {}, h("figcaption", {}, expr), h("ul", {}, ...rows, seen.length > MOST_NAMES && h("li", {}, `… ${seen.length - MOST_NAMES} more`)));
  }

  /** What the numbers are that a colormap shows. */
  private caption(): string {
    const { quantity } = this.store.document.project ?? {};
    const how = this.stage.head?.how;
    if (!how || !quantity) return "intensity";
    const unit = how === "integral" ? "" : prettyUnit(this.server.info?.fields.find((f) => f.name === quantity)?.unit);
    return `${MODES[how] ?? how} of ${quantity}${unit ? ` (${unit})` : ""}`;
  }

  private bar(expr: string, media: { medium: Table; i: number }[]): HTMLElement {
    const { open } = this.store;
    const ends = media.flatMap(({ medium, i }) => {
      const center = given(medium, "center", open, i);
      const width = given(medium, widthName(medium), open, i);
      if (isShell(medium) && center !== null && width !== null) return [center - 3 * width, center + 3 * width];
      if (medium.type === "isosurface") return [given(medium, "level", open, i)];
      if (medium.type === "table") return (medium.values ?? []).map((v: any) => Number.parseFloat(v));
      return [given(medium, "vmin", open, i), given(medium, "vmax", open, i)];
    }).filter((v): v is number => v !== null && Number.isFinite(v));
    let [low, high] = [Math.min(...ends), Math.max(...ends)];
    if (!(high > low)) [low, high] = [low - 0.5 * Math.abs(low || 1), low + 0.5 * Math.abs(low || 1)];
    const canvas = h("canvas", { width: WIDTH, height: 1, class: "vlm-colorbar" });
    const context = canvas.getContext("2d")!;
    for (let x = 0; x < WIDTH; x++) {
      const rgb = this.colorAt(low + ((x + 0.5) / WIDTH) * (high - low), media, (high - low) / WIDTH);
      context.fillStyle = `rgb(${rgb.map((v) => Math.round(255 * Math.min(1, v))).join(",")})`;
      context.fillRect(x, 0, 1, 1);
    }
    const unit = prettyUnit(this.server.info?.fields.find((f) => f.name === expr)?.unit);
    return h(
      "figure", {},
      h("figcaption", {}, unit ? `${expr} (${unit})` : expr), canvas,
      h("div", { class: "vlm-marks" }, ...[low, 0.5 * (low + high), high].map((v) => h("span", {}, pretty(v)))),
    );
  }

  /** Each medium at its full colour where it is: a bar says where hues are, not how bright. */
  private colorAt(x: number, media: { medium: Table; i: number }[], step: number): number[] {
    const { open } = this.store;
    const sum = [0, 0, 0];
    for (const { medium, i } of media) {
      const surface = medium.type === "isosurface";
      const { tau, light } = shareAt(medium, x, open, i, this.stage.tables);
      const near = Math.abs(x - (given(medium, "level", open, i) ?? NaN)) < 1.5 * step ? 1 : 0;
      const weight = surface ? near : Math.min(1, tau / (strengthOf(medium) || 1));
      const color = colorOf(surface ? medium.color ?? 1 : light.length ? light : 1);
      const most = Math.max(...color) || 1;
      for (let k = 0; k < 3; k++) sum[k] += (weight * color[k]) / most;
    }
    return sum;
  }
}
