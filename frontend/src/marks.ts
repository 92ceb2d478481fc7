// Measures as lines above the picture: distances, angles and boxes at their places in space.

import type { Stage } from "./stage";
import { svg } from "./ui/dom";
import { cross, dot, length, sub } from "./vec";
import type { Table, Vec3, VolumeInfo } from "./wire";

/** The angle at the second of three points, in degrees. */
export function angleOf([a, vertex, b]: Vec3[]): number {
  const [one, other] = [sub(a, vertex), sub(b, vertex)];
  return (Math.atan2(length(cross(one, other)), dot(one, other)) * 180) / Math.PI;
}

export const lengthOf = ([a, b]: Vec3[]): number => length(sub(b, a));

/** The edges of a box, in one stroke from corner to corner. */
const STROKE = [0, 1, 3, 2, 0, 4, 5, 7, 6, 4, 5, 1, 3, 7, 6, 2];

/** A line in space, and what is written above its highest point. */
export interface Mark {
  points: Vec3[];
  words: string;
}

/** The line of a measure; of one without places of its own a point. */
export function lineOf({ points, low, high }: Table, place: Vec3 | null): Vec3[] {
  if (low) return STROKE.map((i) => [0, 1, 2].map((k) => ((i >> k) & 1 ? high : low)[k]) as Vec3);
  return points ?? (place ? [place] : []);
}

/** @param hidden whether some of it is behind what cannot be looked through */
export function drawMark(stage: Stage, { points, words }: Mark, hidden: boolean): SVGElement | null {
  const at = points.map((point) => stage.toPixels(point));
  if (stage.frameView!.type === "perspective" && at.some(({ depth }) => depth <= 0)) return null;
  const d = at.map(({ x, y }, i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
  const dots = at.length > 3 ? [] : at.map(({ x, y }) => svg("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: 3.5 }));
  const top = at.reduce((best, one) => (one.y < best.y ? one : best));
  return svg(
    "g", { class: hidden ? "vlm-measured vlm-partly" : "vlm-measured" },
    svg("path", { d, class: "vlm-rim" }), svg("path", { d }), ...dots,
    svg("text", { x: top.x.toFixed(1), y: (top.y - 10).toFixed(1) }, words),
  );
}

/** A box that fills the middle half of a volume. */
export function middleBox(info: VolumeInfo): { low: Vec3; high: Vec3 } {
  const part = (w: number) => info.bounds.map(([a, b]) => Number((a + w * (b - a)).toPrecision(6))) as Vec3;
  return { low: part(0.25), high: part(0.75) };
}
