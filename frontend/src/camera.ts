// The camera that the page turns: RADMC-3D's angles (incl, phi, posang), parallel or from a point.
// Every function returns a new view; nothing here knows of pixels or of the screen.

import { add, along, type Axes, combine, cross, dot, length, sub, times, turn, unit, type Vec3 } from "./vec";
import type { Plane, Table } from "./wire";

export interface View {
  type: "orthographic" | "perspective";
  /** Degrees. */
  incl: number;
  phi: number;
  posang: number;
  /** The point in the middle of the picture (for a perspective camera: its target). */
  center: Vec3;
  /** Longer side of the picture: a length, or for a perspective camera radians on the screen. */
  width: number;
  /** From the observer to the center; of no meaning for parallel rays. */
  distance: number;
  /** What rotations turn about; the center if null. */
  pivot: Vec3 | null;
  /** The whole table of a camera whose picture is no plane (a dome, two eyes): it is only turned. A panorama turns where it is. */
  base: Table | null;
}

/** Whether a camera's picture is a plane, which can be moved and zoomed. */
export const isFlat = (camera: Table): boolean => camera.type !== "panorama" && (camera.projection ?? "flat") === "flat" && !camera.stereo;

const DEGREE = Math.PI / 180;

/** Cosine and sine, exact at multiples of 90 degrees as Python's are. */
function cosineSine(degrees: number): [number, number] {
  const turned = ((degrees % 360) + 360) % 360;
  const quarter = Math.floor(turned / 90);
  if (turned === quarter * 90) return ([[1, 0], [0, 1], [-1, 0], [0, -1]] as [number, number][])[quarter % 4];
  return [Math.cos(degrees * DEGREE), Math.sin(degrees * DEGREE)];
}

/** The image's x axis, y axis and the direction to the observer: `rotation.image_axes` of Python. */
export function imageAxes(incl: number, phi: number, posang: number): Axes {
  const [ci, si] = cosineSine(incl);
  const [cp, sp] = cosineSine(phi);
  const [ca, sa] = cosineSine(posang);
  const aboutZ = (v: Vec3, c: number, s: number): Vec3 => [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]];
  const aboutX = (v: Vec3): Vec3 => [v[0], ci * v[1] - si * v[2], si * v[1] + ci * v[2]];
  const turned = (v: Vec3): Vec3 => aboutZ(aboutX(aboutZ(v, ca, sa)), cp, sp);
  return [turned([1, 0, 0]), turned([0, 1, 0]), turned([0, 0, 1])];
}

/** The angles of axes, the inverse of `imageAxes`; `phi` is kept where it means nothing. */
export function anglesOf(axes: Axes, phi = 0): { incl: number; phi: number; posang: number } {
  const [x, y, z] = axes[2];
  const aside = Math.hypot(x, y);
  const incl = Math.atan2(aside, z) / DEGREE;
  const around = aside < 1e-9 ? phi : Math.atan2(-x, -y) / DEGREE;
  const level = imageAxes(incl, around, 0);
  const posang = Math.atan2(dot(axes[1], level[0]), dot(axes[1], level[1])) / DEGREE;
  return { incl, phi: around, posang: Math.abs(posang) < 1e-9 ? 0 : posang };
}

export const axesOf = (view: View): Axes => imageAxes(view.incl, view.phi, view.posang);

export function positionOf(view: View): Vec3 {
  return add(view.center, times(axesOf(view)[2], view.distance));
}

/** Width and height of the plane through the center, for a picture of this aspect (width/height). */
export function extent(view: View, aspect: number): [number, number] {
  const longer = view.type === "perspective" ? view.width * view.distance : view.width;
  return aspect >= 1 ? [longer, longer / aspect] : [longer * aspect, longer];
}

/** The view that a frame was drawn with; angles are the camera's own where it has them. */
export function viewOf(camera: Table, plane: Plane): View {
  const tilted: Axes = [plane.right, plane.up, times(plane.ahead, -1)];
  const axes = camera.zenith ? (tilted.map((v) => turn(v, plane.right, -camera.zenith * DEGREE)) as Axes) : tilted;
  const own = camera.type === "orthographic" && typeof camera.incl === "number";
  const angles = own
    ? { incl: camera.incl, phi: camera.phi ?? 0, posang: camera.posang ?? 0 }
    : anglesOf(axes, camera.phi ?? 0);
  const moved = combine(axes, [plane.shift[0], plane.shift[1], 0]);
  const width = Math.max(plane.width, plane.height);
  const distance = plane.position ? length(sub(plane.center, plane.position)) : 1;
  return {
    type: plane.position ? "perspective" : "orthographic",
    ...angles,
    center: plane.position ? plane.center : add(plane.center, moved),
    width,
    distance,
    pivot: null,
    base: isFlat(camera) ? null : camera,
  };
}

/** The camera's table for the server: plain numbers, in the volume's unit. */
export function tableOf(view: View): Table {
  const round = (v: number) => Number(v.toFixed(6));
  if (view.base) {
    const { posang, up, view_direction, ...rest } = view.base;
    if (view.type === "orthographic") return { ...rest, incl: round(view.incl), phi: round(view.phi), posang: round(view.posang) };
    const position = rest.type === "panorama" ? rest.position : positionOf(view);
    return { ...rest, position, target: view.center, up: axesOf(view)[1] };
  }
  if (view.type === "orthographic") {
    const { type, width, center } = view;
    return { type, incl: round(view.incl), phi: round(view.phi), posang: round(view.posang), width, center };
  }
  // The direction that is up says the same as posang, and also where one looks along the z axis.
  return { type: view.type, position: positionOf(view), target: view.center, width: view.width, up: axesOf(view)[1] };
}

/** The view of a camera's table that `tableOf` wrote. */
export function viewFrom(table: Table): View {
  const { incl = 0, phi = 0, posang = 0, center, width } = table;
  const type = table.position ? ("perspective" as const) : ("orthographic" as const);
  const view = { type, incl, phi, posang, center, width, distance: 1, pivot: null, base: isFlat(table) ? null : table };
  if (!table.position) return view;
  const back = sub(table.position, table.target);
  const distance = length(back);
  const axis = times(back, 1 / distance);
  const angles = anglesOf([cross(table.up, axis), table.up, axis]);
  return { ...view, ...angles, center: table.target, distance };
}

/** Other angles, turning about the pivot: what is there stays where it is in the picture. */
export function withAngles(view: View, angles: { incl: number; phi: number; posang: number }): View {
  const next = { ...view, ...angles };
  const pivot = view.base?.type === "panorama" ? positionOf(view) : view.pivot;
  if (!pivot) return next;
  const arm = along(axesOf(view), sub(view.center, pivot));
  return { ...next, center: add(pivot, combine(axesOf(next), arm)) };
}

const wrapped = (degrees: number): number => degrees - 360 * Math.round(degrees / 360);

/** Turntable: what is in front follows the hand; z stays upright, the pole stops. Degrees. */
export function orbit(view: View, right: number, up: number): View {
  const [c, s] = cosineSine(view.posang);
  const across = c * right + s * up;
  const upwards = c * up - s * right;
  const incl = Math.min(180, Math.max(0, view.incl + upwards));
  return withAngles(view, { incl, phi: wrapped(view.phi + across), posang: view.posang });
}

/** Degrees across the picture of a panorama, whose places are directions; null of others. */
export function sweep({ base }: View): number | null {
  if (base?.type !== "panorama") return null;
  const one = base.projection === "fulldome" ? base.fov ?? 180 : base.projection === "cubemap" ? 270 : 360;
  return base.stereo === "side-by-side" ? 2 * one : one;
}

/** Turn the picture in its plane, anticlockwise. */
export function roll(view: View, degrees: number): View {
  return withAngles(view, { ...view, posang: wrapped(view.posang + degrees) });
}

/** A point of the ball under the picture; outside it the nearest of its rim. */
function onBall(x: number, y: number): Vec3 {
  const r = x * x + y * y;
  if (r < 1) return [x, y, Math.sqrt(1 - r)];
  return [x / Math.sqrt(r), y / Math.sqrt(r), 0];
}

/**
 * Trackball from where the hand went down to where it is (-1 to 1 across the shorter side).
 * The rotation is twice the arc (Shoemake), so it depends on these two points alone and not on the
 * way between them: going back to the start undoes it.
 */
export function trackball(view: View, from: [number, number], to: [number, number]): View {
  const a = onBall(...from);
  const b = onBall(...to);
  const axis = cross(a, b);
  const sine = length(axis);
  if (sine < 1e-12) return view;
  const axes = axesOf(view);
  const around = combine(axes, unit(axis));
  // The object turns with the hand, so the camera turns the other way.
  const angle = -2 * Math.atan2(sine, dot(a, b));
  const turned = axes.map((v) => turn(v, around, angle)) as Axes;
  return withAngles(view, anglesOf(turned, view.phi));
}

/** Move the picture by parts of its longer side. */
export function pan(view: View, right: number, up: number): View {
  if (view.base) return view;
  const longer = extent(view, 1)[0];
  const axes = axesOf(view);
  return { ...view, center: sub(view.center, combine(axes, [right * longer, up * longer, 0])) };
}

/** Zoom in by a factor so that the point at (x, y), parts of the longer side from the middle, stays. */
export function zoom(view: View, factor: number, x: number, y: number): View {
  if (view.base) return view;
  const longer = extent(view, 1)[0];
  const fixed = add(view.center, combine(axesOf(view), [x * longer, y * longer, 0]));
  const center = add(fixed, times(sub(view.center, fixed), 1 / factor));
  if (view.type === "orthographic") return { ...view, center, width: view.width / factor };
  return { ...view, center, distance: view.distance / factor };
}

/** From parallel rays to an observer who sees as much at the center's distance, or back. */
export function otherType(view: View): View {
  if (view.base) return view;
  if (view.type === "perspective") return { ...view, type: "orthographic", width: view.width * view.distance };
  const width = 2 * Math.tan(22.5 * DEGREE);
  return { ...view, type: "perspective", width, distance: view.width / width };
}

/** See all of the domain from where one is. */
export function fit(view: View, bounds: [number, number][], aspect: number): View {
  if (view.base) return view;
  const axes = axesOf(view);
  const half = bounds.map(([a, b]) => (b - a) / 2) as Vec3;
  const middle = bounds.map(([a, b]) => (a + b) / 2) as Vec3;
  const reach = axes.map((v) => Math.abs(v[0]) * half[0] + Math.abs(v[1]) * half[1] + Math.abs(v[2]) * half[2]);
  const shorter = Math.min(aspect, 1 / aspect);
  const [x, y] = aspect >= 1 ? [reach[0], reach[1] / shorter] : [reach[0] / shorter, reach[1]];
  const longer = 2.06 * Math.max(x, y);
  const framed = { ...view, center: middle, pivot: null };
  if (view.type === "orthographic") return { ...framed, width: longer };
  return { ...framed, distance: longer / view.width + reach[2] };
}

const SIDES: Record<string, [number, number]> = {
  x: [90, -90],
  X: [90, 90],
  y: [90, 180],
  Y: [90, 0],
  z: [0, 0],
  Z: [180, 0],
};

/** Look from the positive end of an axis (x, y, z) or from its negative one (X, Y, Z). */
export function fromSide(view: View, side: string): View {
  const [incl, phi] = SIDES[side];
  return withAngles(view, { incl, phi, posang: 0 });
}

/** Where a point is in the picture: parts of the longer side from the middle, and its distance. */
export function project(view: View, point: Vec3): { x: number; y: number; depth: number } {
  const [u, v, back] = along(axesOf(view), sub(point, view.center));
  if (view.type === "orthographic") return { x: u / view.width, y: v / view.width, depth: -back };
  const ahead = view.distance - back;
  return { x: u / ahead / view.width, y: v / ahead / view.width, depth: ahead };
}

/**
 * How a picture drawn with one view is shifted and zoomed to stand in for another until that comes:
 * places (parts of the longer side) become scale · place + (x, y). Rotations are left out.
 */
export function standIn(from: View, to: View): { scale: number; x: number; y: number } {
  const scale = extent(from, 1)[0] / extent(to, 1)[0];
  // The pivot is what stays in place of a rotation.
  const fixed = to.pivot ?? from.center;
  const now = project(to, fixed);
  const then = project(from, fixed);
  if (!(now.depth > 0) && to.type === "perspective") return { scale: 1, x: 0, y: 0 };
  return { scale, x: now.x - scale * then.x, y: now.y - scale * then.y };
}
