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

/** Corners of a box, x changing first. */
const cornersOf = (low: Vec3, high: Vec3): Vec3[] => [...Array(8).keys()].map((i) => low.map((v, k) => ((i >> k) & 1 ? high[k] : v)) as Vec3);

export interface Mark {
  measure: Table;
  words: string;
  /** Where the words are, of a measure that has no points of its own. */
  place: Vec3 | null;
  /** Which of its points are in front of what cannot be looked through. */
  seen: boolean[];
}

function pointsOf({ measure, place }: Pick<Mark, "measure" | "place">): Vec3[] {
  if (measure.points) return measure.points;
  if (measure.low) return cornersOf(measure.low, measure.high);
  return place ? [place] : [];
}

export function drawMark(stage: Stage, mark: Mark): SVGElement | null {
  const points = pointsOf(mark);
  if (!points.length || (mark.seen.length && !mark.seen.includes(true))) return null;
  const at = points.map((point) => stage.toPixels(point));
  if (stage.frameView!.type === "perspective" && at.some(({ depth }) => depth <= 0)) return null;
  const pairs = mark.measure.low && !mark.measure.points ? edges() : points.slice(1).map((_, i) => [i, i + 1]);
  const path = pairs.map(([i, j]) => `M${at[i].x.toFixed(1)} ${at[i].y.toFixed(1)}L${at[j].x.toFixed(1)} ${at[j].y.toFixed(1)}`).join("");
  const dots = pairs.length > 3 ? [] : at.map(({ x, y }) => svg("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: 3.5 }));
  const top = at.reduce((best, one) => (one.y < best.y ? one : best));
  return svg(
    "g", { class: mark.seen.includes(false) ? "vlm-measured vlm-partly" : "vlm-measured" },
    path && svg("path", { d: path, class: "vlm-rim" }), path && svg("path", { d: path }), ...dots,
    svg("text", { x: top.x.toFixed(1), y: (top.y - 10).toFixed(1) }, mark.words),
  );
}

const edges = (): number[][] => [...Array(8).keys()].flatMap((i) => [1, 2, 4].filter((bit) => !(i & bit)).map((bit) => [i, i | bit]));

/** A box that fills the middle half of a volume. */
export function middleBox(info: VolumeInfo): { low: Vec3; high: Vec3 } {
  const part = (w: number) => info.bounds.map(([a, b]) => Number((a + w * (b - a)).toPrecision(6))) as Vec3;
  return { low: part(0.25), high: part(0.75) };
}
