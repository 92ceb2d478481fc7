// Media of the document: what they are called, how strong they are, and their shapes over the values
// of an expression. Strength is an optical depth: of one crossing of a shell or a surface.

import type { Patch } from "./store";
import { colorOf } from "./ui/color";
import { pretty, numberOf, likewise, lengthIn } from "./ui/format";
import type { Table } from "./wire";

export const TYPES = ["gaussian", "rectangle", "isosurface", "colormap", "table", "coefficients"];
export const NAMES: Record<string, string> = {
  gaussian: "Shell (Gaussian)",
  rectangle: "Shell (rectangle)",
  isosurface: "Surface",
  colormap: "Colormap",
  table: "Table",
  coefficients: "Emission and extinction",
  labels: "Labels",
};
const SHORT: Record<string, string> = {
  gaussian: "shell", rectangle: "shell", isosurface: "surface", colormap: "colormap", table: "table", coefficients: "coefficients",
  labels: "labels",
};
/** Strength of the sliders: log10 of the optical depth. */
export const WEAKEST = -4;
export const STRONGEST = 3;
const MOST_OPAQUE = 1 - 1e-6;

const mean = (list: number[]) => list.reduce((a, b) => a + b, 0) / Math.max(list.length, 1);
const numbers = (value: any): number[] => [value].flat(Infinity).map(numberOf).filter((v) => v !== null);

export const widthName = (medium: Table): "sigma" | "half_width" => (medium.type === "rectangle" ? "half_width" : "sigma");
export const isShell = (medium: Table): boolean => medium.type === "gaussian" || medium.type === "rectangle";

/** A number of a medium; of one that is left open the one that the server measured. */
export function given(medium: Table, name: string, open: Table, index: number): number | null {
  const own = numberOf(Array.isArray(medium[name]) ? medium[name][0] : medium[name]);
  return own ?? numberOf(open[`medium.${index}.${name}`]);
}

export function titleOf(medium: Table): string {
  if (medium.type === "labels") return `${medium.expr}: ${medium.visible.filter(Boolean).length} of ${medium.numbers.length}`;
  if (medium.type === "coefficients") return `${medium.emissivity ?? 0}, ${medium.extinction ?? 0}`;
  const at = numberOf(medium.center ?? (Array.isArray(medium.level) ? medium.level[0] : medium.level));
  return at === null ? medium.expr ?? "" : `${medium.expr} = ${pretty(at)}`;
}

export const kindOf = (medium: Table): string => SHORT[medium.type] ?? medium.type;

/** Optical depth of one crossing (of one path length); the largest of a table. */
export function strengthOf(medium: Table): number {
  if (medium.type === "isosurface") return -Math.log(1 - Math.min(mean(numbers(medium.opacity ?? 0.3)), MOST_OPAQUE));
  if (medium.type === "table") return Math.max(0, ...numbers(medium.opacities ?? 0));
  return mean(numbers(medium.opacity ?? (medium.type === "colormap" ? 1 : 0)));
}

/** The colour by which a medium is known in lists: of a table that of its strongest entry. */
export function colorFor(medium: Table): any {
  if (medium.color) return medium.color;
  const opacities = [medium.opacities ?? []].flat().map((o: any) => mean(numbers(o)));
  return medium.colors?.[Math.max(0, opacities.indexOf(Math.max(...opacities)))] ?? [1, 1, 1];
}

function scaled(value: any, factor: number): any {
  if (Array.isArray(value)) return value.map((v) => scaled(v, factor));
  return typeof value === "number" ? Number((value * factor).toPrecision(6)) : value;
}

/**
 * Changes that make a medium as strong as `tau`. With `locked` it glows as much more as it absorbs
 * more, so that the source function, its colour where it is thick, stays.
 */
export function strengthened(medium: Table, index: number, tau: number, locked: boolean): Patch {
  const at = `medium.${index}.`;
  const old = strengthOf(medium);
  if (medium.type === "isosurface") {
    const opacity = Number((1 - Math.exp(-tau)).toPrecision(6));
    return [[at + "opacity", Array.isArray(medium.opacity) ? medium.opacity.map(() => opacity) : opacity]];
  }
  const name = medium.type === "table" ? "opacities" : "opacity";
  const factor = old > 0 ? tau / old : 0;
  const value = factor > 0 ? scaled(medium[name] ?? 1, factor) : Number(tau.toPrecision(6));
  const patch: Patch = [[at + name, value]];
  const color = medium.type === "table" ? "colors" : "color";
  const numeric = Array.isArray(medium[color]) || typeof medium[color] === "number";
  if (locked && factor > 0 && numeric) patch.push([at + color, scaled(medium[color], factor)]);
  return patch;
}

/** Whether emission can follow the strength: colours of surfaces and colormaps do so by definition. */
export const canLock = (medium: Table): boolean => isShell(medium) || medium.type === "table";

/** What one path length of a medium has where its expression is x: optical depth, and light per channel. */
export interface Share {
  tau: number;
  /** Empty if it depends on another expression. */
  light: number[];
}

const lightOf = (color: any): number[] => (Array.isArray(color) ? color : typeof color === "string" ? colorOf(color) : typeof color === "number" ? [color] : []);

export function shareAt(medium: Table, x: number, open: Table, index: number, maps: Map<string, Uint8Array>): Share {
  const tau = strengthOf(medium);
  const number = (name: string) => given(medium, name, open, index) ?? NaN;
  if (isShell(medium)) {
    const away = (x - number("center")) / number(widthName(medium));
    const part = medium.type === "gaussian" ? Math.exp(-0.5 * away ** 2) || 0 : Math.abs(away) <= 1 ? 1 : 0;
    return { tau: part * tau, light: lightOf(medium.color ?? 1).map((v) => part * v) };
  }
  if (medium.type === "colormap") {
    const f = medium.norm === "log" ? Math.log : (v: number) => v;
    const place = (f(x) - f(number("vmin"))) / (f(number("vmax")) - f(number("vmin")));
    const map = maps.get(medium.cmap);
    const at = 3 * Math.min(255, Math.max(0, Math.floor(256 * place)));
    return { tau, light: map && at >= 0 ? [...map.subarray(at, at + 3)].map((v) => (tau * v) / 255) : [] };
  }
  if (medium.type !== "table") return { tau: 0, light: [] };
  // Linear in between, and constant beyond the ends.
  const values = numbers(medium.values);
  const above = values.findIndex((v) => v >= x);
  const b = above < 0 ? values.length - 1 : above;
  const a = above < 0 ? b : Math.max(0, b - 1);
  const t = b > a ? (x - values[a]) / (values[b] - values[a]) : 0;
  const between = (list: number[]) => (1 - t) * list[a] + t * (list[b] ?? list[a]);
  const lights = values.map((_, k) => lightOf(medium.colors?.[k]));
  const opacities = values.map((_, k) => mean(numbers(Array.isArray(medium.opacities) ? medium.opacities[k] : medium.opacities ?? 0)));
  return { tau: between(opacities), light: lights[0].map((_, c) => between(lights.map((light) => light[c]))) };
}

/**
 * Extinction and emission (per channel) of all media together, per unit of length, where an expression has
 * the values xs; null if there are none, or one's path length has a unit that the page does not know.
 */
export function totals(media: Table[], expr: string, xs: number[], open: Table, maps: Map<string, Uint8Array>, channels: number, unit: string) {
  const parts = media.flatMap((medium, i) => {
    if (medium.hidden || medium.expr !== expr || medium.type === "isosurface" || medium.type === "labels") return [];
    const own = lengthIn(medium.path_length, unit) ?? (numberOf(medium.path_length) === null ? open[`medium.${i}.path_length`] : NaN);
    return [xs.map((x) => shareAt(medium, x, open, i, maps)).map(({ tau, light }) => ({ alpha: tau / own, j: light.map((v) => v / own) }))];
  });
  const sum = (of: (share: { alpha: number; j: number[] }) => number) => xs.map((_, k) => parts.reduce((all, part) => all + of(part[k]), 0));
  const alpha = sum((share) => share.alpha);
  const j = [...Array(channels).keys()].map((c) => sum((share) => share.j[c] ?? share.j[0] ?? 0));
  return parts.length && alpha.every(Number.isFinite) ? { alpha, j } : null;
}

/** Words for a strength: what one crossing takes away. */
export function absorbed(tau: number): string {
  const part = 100 * (1 - Math.exp(-tau));
  return `${pretty(part, part > 99 ? 4 : 2)} % absorbed`;
}

/** A new medium where there are values: at `center`, in the middle of the range if there is none. */
export function fresh(type: string, expr: string, [low, high]: [number, number], center: number | null, color: string, channels = 3): Table {
  const round = (v: number) => Number(v.toPrecision(4));
  const middle = round(center ?? 0.5 * (low + high));
  const width = round(0.02 * (high - low) || 0.1);
  const rgb = [1, 3, 5].map((i) => Number((parseInt(color.slice(i, i + 2), 16) / 255).toFixed(3)));
  switch (type) {
    case "rectangle":
      return { type, expr, center: middle, half_width: width, color: scaled(rgb, 0.3), opacity: 0.3 };
    case "isosurface":
      return { type, expr, level: middle, color: rgb, opacity: 0.3, shading: 0.5 };
    case "colormap":
      return { type, expr, cmap: "viridis", vmin: round(low), vmax: round(high), opacity: 0.3 };
    case "table": {
      const values = [-2, 0, 2].map((k) => round(middle + k * width));
      return { type, expr, values, colors: [rgb, rgb, rgb].map((c) => scaled(c, 0.3)), opacities: [0.001, 0.3, 0.001] };
    }
    case "coefficients":
      return { type, emissivity: channels > 1 ? Array(channels).fill(expr) : expr, extinction: expr };
    default:
      return { type: "gaussian", expr, center: middle, sigma: width, color: scaled(rgb, 0.3), opacity: 0.3 };
  }
}

/** Another number for a quantity, rounded to what a hand can mean, in the unit it had. */
export function another(old: any, value: number): number | string {
  return likewise(old, Number(value.toPrecision(6)));
}
