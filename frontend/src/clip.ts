// The part of space that is drawn, as the page cuts it: a box, and what is behind a plane. In the
// document it is the text of a region, `render.clip`, with plain numbers in the volume's unit.

import { add, dot, sub, times, unit, type Vec3 } from "./vec";

export interface Clip {
  /** Two corners. */
  box: [Vec3, Vec3];
  plane: { normal: Vec3; depth: number } | null;
}

const NUMBER = "\\s*(-?[\\d.]+(?:e[-+]?\\d+)?)\\s*";
const POINT = `\\(${[NUMBER, NUMBER, NUMBER].join(",")}\\)`;
const PAIR = `\\(${POINT}\\s*,\\s*${POINT}\\)`;
const WHOLE = new RegExp(`^\\(*(?:box${PAIR})?(?:\\)*\\s*&\\s*)?(?:halfspace${PAIR})?\\)*$`);

export const wholeOf = (bounds: [number, number][]): Clip => ({
  box: [0, 1].map((k) => bounds.map((b) => b[k]) as Vec3) as [Vec3, Vec3],
  plane: null,
});

/** The clip of a text that `textOf` wrote; null for other regions, which only scene files have. */
export function clipOf(text: string, bounds: [number, number][]): Clip | null {
  const found = WHOLE.exec(text);
  if (!found || !text) return null;
  const vectors = [1, 4, 7, 10].map((i) => found.slice(i, i + 3).map(Number) as Vec3);
  const normal = found[7] === undefined ? null : unit(vectors[3]);
  return {
    box: found[1] === undefined ? wholeOf(bounds).box : [vectors[0], vectors[1]],
    plane: normal && { normal, depth: dot(vectors[2], normal) },
  };
}

/** The text of a clip; null for all of the volume. */
export function textOf({ box, plane }: Clip, bounds: [number, number][]): string | null {
  const point = (v: number[]) => `(${v.map(written).join(", ")})`;
  const sizes = bounds.map(([a, b]) => b - a);
  const whole = wholeOf(bounds).box;
  const parts: string[] = [];
  if (JSON.stringify(box) !== JSON.stringify(whole)) {
    // Ends of the volume to the last digit, others to the digits of a slider.
    const ends = box.map((v, k) => point(v.map((x, i) => (x === whole[k][i] ? x : rounded(x, sizes[i])))));
    parts.push(`box(${ends.join(", ")})`);
  }
  if (plane) {
    const middle = times(add(...whole), 0.5);
    const at = add(middle, times(plane.normal, plane.depth - dot(middle, plane.normal)));
    const places = at.map((x, k) => rounded(x, sizes[k]));
    parts.push(`halfspace(${point(places)}, ${point(plane.normal.map((x) => rounded(x, 1)))})`);
  }
  return parts.join(" & ") || null;
}

const rounded = (x: number, size: number): number => {
  const step = 10 ** (Math.floor(Math.log10(size)) - 6);
  const n = Math.round(x / step);
  return n ? Number((n * step).toPrecision(7)) : 0;
};

/** As short as can be, and the same number when it is read. */
const written = (x: number): string => [String(x), x.toExponential()].sort((a, b) => a.length - b.length)[0];

/** Least and largest depth of the corners of a box along a direction. */
export function depths(bounds: [number, number][], normal: Vec3): [number, number] {
  const ends = bounds.map(([a, b], k) => [a * normal[k], b * normal[k]].sort((x, y) => x - y));
  return [0, 1].map((i) => ends.reduce((sum, end) => sum + end[i], 0)) as [number, number];
}

/** Corners of a box: bit k of a number says which end of axis k. */
export const corner = ({ box }: Clip, i: number): Vec3 => [0, 1, 2].map((k) => box[(i >> k) & 1][k]) as Vec3;

/** The polygon in which the plane cuts the box, around its middle; empty where they do not meet. */
export function section(clip: Clip): Vec3[] {
  if (!clip.plane) return [];
  const { normal, depth } = clip.plane;
  const found: Vec3[] = [];
  for (let i = 0; i < 8; i++) {
    for (const bit of [1, 2, 4]) {
      if (i & bit) continue;
      const [a, b] = [corner(clip, i), corner(clip, i | bit)];
      const [from, to] = [dot(a, normal) - depth, dot(b, normal) - depth];
      if (from * to < 0) found.push(add(a, times(sub(b, a), from / (from - to))));
    }
  }
  if (!found.length) return [];
  const middle = times(found.reduce(add), 1 / found.length);
  const right = unit(sub(found[0], middle));
  const up: Vec3 = [
    normal[1] * right[2] - normal[2] * right[1],
    normal[2] * right[0] - normal[0] * right[2],
    normal[0] * right[1] - normal[1] * right[0],
  ];
  const angle = (p: Vec3) => Math.atan2(dot(sub(p, middle), up), dot(sub(p, middle), right));
  return found.sort((p, q) => angle(p) - angle(q));
}
