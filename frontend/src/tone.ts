// From intensities to what is shown: the same formulas as `Image.to_rgb` of Python.
// `settle` reads the document's options once; `toneOf` applies them to a pixel. The shader of
// `screen.ts` does what `toneOf` does.

import { colorOf } from "./ui/color";
import type { Table } from "./wire";

/** What the options come to, for one frame. */
export interface Tone {
  /** Red, green and blue of each channel; with a colormap its channel has red 1. */
  mix: [number, number, number][];
  black: number;
  white: number;
  /** v^(1/gamma), or one of two soft curves. */
  curve: "power" | "asinh" | "log";
  gamma: number;
  softening: number;
  hue: boolean;
  colormap: string | null;
  /** Logarithm of the values instead of a curve. */
  logarithmic: boolean;
}

export interface Shown {
  channels: number;
  exposure: number;
  /** Of a projection: which. */
  how?: string;
  limits?: [number, number, number][];
}

export const STRETCHES = ["linear", "sqrt", "gamma", "asinh", "log"];
const SOFTENING: Record<string, number> = { asinh: 0.1, log: 0.01 };
const GAMMA: Record<string, number> = { linear: 1, sqrt: 2, gamma: 2.2 };
// As in `with_colormap` of Python: maps of velocities, and the share of negative values they need.
const SIGNED = "RdBu_r";
const SHARE = 0.1;
const DECADES = 1e-6;
const TWO: [number, number, number][] = [
  [1, 0.6, 0.2],
  [0.1, 0.4, 1],
];

function defaultMix(count: number): [number, number, number][] {
  if (count === 2) return TWO;
  const rows: [number, number, number][] = [];
  for (let i = 0; i < count; i++) {
    rows.push(count === 1 || i > 2 ? [1, 1, 1] : [i === 0 ? 1 : 0, i === 1 ? 1 : 0, i === 2 ? 1 : 0]);
  }
  return rows;
}

/** Options of the document, with the colormap that one channel of both signs gets by itself. */
function completed(image: Table, shown: Shown, chosen: number[]): Table {
  if (image.colormap || image.mix || chosen.length !== 1) return image;
  if (image.norm) return { ...image, colormap: "gray" };
  if ((image.stretch ?? "linear") !== "linear" || (image.gamut ?? "hue") !== "hue") return image;
  if (["background", "vmin", "vmax", "softening"].some((name) => image[name] != null)) return image;
  const [least, , most] = shown.limits?.[chosen[0]] ?? [0, 0, 1];
  if ((most <= 0 || shown.how) && least < 0 && image.exposure == null) {
    return { ...image, colormap: "gray", vmin: least, vmax: most };
  }
  if (most <= 0 || -least < SHARE * most) return image;
  const reach = 1 / (image.exposure ?? shown.exposure);
  return { ...image, colormap: SIGNED, exposure: null, vmin: -reach, vmax: reach };
}

export function settle(given: Table, shown: Shown): Tone {
  const all = [...Array(shown.channels).keys()];
  const asked = given.channels == null ? all : [given.channels].flat();
  const inside = asked.filter((c: number) => c < shown.channels);
  const chosen: number[] = inside.length ? inside : all;
  const plain = given.exposure === "rgb" ? { ...given, exposure: 1, gamut: "clip" } : given;
  const image = completed(plain, shown, chosen);
  const stretch = image.stretch ?? "linear";
  const curve = stretch === "asinh" || stretch === "log" ? stretch : "power";
  const rows = Array.isArray(image.mix) ? image.mix.map((c: any) => colorOf(c)) : defaultMix(chosen.length);
  const mix: [number, number, number][] = all.map(() => [0, 0, 0]);
  const limits = shown.limits?.[chosen[0]];
  let black = Number(image.vmin ?? 0);
  let white = image.exposure != null ? 1 / image.exposure : Number(image.vmax ?? 1 / shown.exposure);
  const logarithmic = image.colormap != null && image.norm === "log";
  if (image.colormap) {
    mix[chosen[0]] = [1, 0, 0];
    if (image.exposure == null && image.vmax == null && limits) white = limits[2];
    if (image.vmin == null && limits) black = logarithmic ? limits[1] : limits[0];
    if (logarithmic && image.vmin == null) black = Math.max(black, DECADES * white);
  } else {
    chosen.forEach((c, i) => {
      for (let k = 0; k < 3; k++) mix[c][k] += rows[i]?.[k] ?? 0;
    });
  }
  return {
    mix,
    black,
    white: white > black || image.colormap ? white : black + 1,
    curve,
    gamma: typeof stretch === "number" ? stretch : GAMMA[stretch] ?? 1,
    softening: image.softening ?? SOFTENING[stretch] ?? 1,
    hue: (image.gamut ?? "hue") === "hue",
    colormap: image.colormap ?? null,
    logarithmic,
  };
}

/** The stretch, of [0, 1] onto itself. */
export function bend(v: number, tone: Tone): number {
  if (tone.curve === "asinh") return Math.asinh(v / tone.softening) / Math.asinh(1 / tone.softening);
  if (tone.curve === "log") return Math.log1p(v / tone.softening) / Math.log1p(1 / tone.softening);
  return v ** (1 / tone.gamma);
}

/** The value whose place on a colour bar is `w`, from 0 to 1: the inverse of what a tone does. */
export function valueAt(w: number, tone: Tone): number {
  const { black, white, softening } = tone;
  if (tone.logarithmic) return black * (white / black) ** w;
  let t = w ** tone.gamma;
  if (tone.curve === "asinh") t = softening * Math.sinh(w * Math.asinh(1 / softening));
  if (tone.curve === "log") t = softening * Math.expm1(w * Math.log1p(1 / softening));
  return black + (white - black) * t;
}

/** Red, green and blue (0 to 1) of the intensities of one pixel. */
export function toneOf(intensity: ArrayLike<number>, tone: Tone, table?: Uint8Array): [number, number, number] {
  const linear: [number, number, number] = [0, 0, 0];
  for (let c = 0; c < tone.mix.length; c++) {
    for (let k = 0; k < 3; k++) linear[k] += tone.mix[c][k] * intensity[c];
  }
  const span = tone.white - tone.black;
  if (tone.colormap !== null) {
    const value = linear[0];
    if (value === -Infinity) return [0, 0, 0];
    const place = tone.logarithmic
      ? Math.log(Math.max(value, tone.black) / tone.black) / Math.log(tone.white / tone.black)
      : span > 0 ? bend(Math.min(Math.max((value - tone.black) / span, 0), 1), tone) : 0;
    const entry = Math.min(Math.max(Math.floor(place * 256), 0), 255);
    if (!table) return [entry / 255, entry / 255, entry / 255];
    return [table[3 * entry] / 255, table[3 * entry + 1] / 255, table[3 * entry + 2] / 255];
  }
  for (let k = 0; k < 3; k++) linear[k] = Math.min(Math.max((linear[k] - tone.black) / span, 0), 1e30);
  if (!tone.hue) return linear.map((v) => bend(Math.min(v, 1), tone)) as [number, number, number];
  const brightest = Math.max(...linear);
  if (!(brightest > 0)) return [0, 0, 0];
  const factor = bend(Math.min(brightest, 1), tone);
  return linear.map((v) => Math.min((v / brightest) * factor, 1)) as [number, number, number];
}
