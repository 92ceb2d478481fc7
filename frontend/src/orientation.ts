// Which side of a patient is where, and views by their names, if the volume says how it lies.

import { fromSide, type View, withAngles } from "./camera";
import type { Vec3, VolumeInfo } from "./wire";

export const OPPOSITE: Record<string, string> = { L: "R", R: "L", A: "P", P: "A", S: "I", I: "S" };
/** An axis of the patient that is within 66° of a direction gives it a letter. */
const NEAR = 0.4;

export const NAMES: Record<string, string> = { A: "anterior", P: "posterior", L: "left", R: "right", S: "superior", I: "inferior" };

/** The letters of a direction of the volume, that of the nearest axis first; none where it does not say how it lies. */
export function lettersOf(info: VolumeInfo, way: Vec3): string {
  const code = info.views?.anterior ? info.orientation!.toUpperCase() : "";
  const turned = info.direction ? info.direction.map((row) => row[0] * way[0] + row[1] * way[1] + row[2] * way[2]) : way;
  return [...code]
    .map((letter, k) => ({ letter: turned[k] > 0 ? letter : OPPOSITE[letter], size: Math.abs(turned[k]) }))
    .filter(({ size }) => size > NEAR)
    .sort((a, b) => b.size - a.size)
    .map(({ letter }) => letter)
    .join("");
}

/** The letter at the end of an axis (x, y, z; X, Y, Z are the other ends). */
export function letterOf(info: VolumeInfo, axis: string): string {
  const sign = axis === axis.toLowerCase() ? 1 : -1;
  // Cells that are turned are named after the nearest axis.
  const way = ["x", "y", "z"].map((name) => (name === axis.toLowerCase() ? sign : 0)) as Vec3;
  return lettersOf({ ...info, direction: undefined }, way);
}

/** Look from a side by its letter or name, or from the end of an axis; null if the volume does not say which way that is. */
export function fromNamed(info: VolumeInfo, view: View, side: string): View | null {
  const angles = info.views?.[NAMES[side] ?? side];
  if (angles) return withAngles(view, angles);
  if (!/^[xyz]$/i.test(side)) return null;
  const letter = letterOf(info, side);
  return letter ? fromNamed(info, view, letter) : fromSide(view, side);
}
