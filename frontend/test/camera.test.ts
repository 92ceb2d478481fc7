// Cameras against Python's, and what hands may rely on.

import assert from "node:assert/strict";
import { test } from "node:test";
import * as camera from "../src/camera";
import { dot, length, sub, type Vec3 } from "../src/vec";
import fixtures from "./fixtures.json";

const close = (a: ArrayLike<number>, b: ArrayLike<number>, off = 1e-8) => {
  assert.equal(a.length, b.length);
  for (let i = 0; i < a.length; i++) assert.ok(Math.abs(a[i] - b[i]) <= off * (1 + Math.abs(b[i])), `${[...Array.from(a)]} is not ${[...Array.from(b)]}`);
};
const view: camera.View = {
  type: "orthographic", incl: 60, phi: 30, posang: 20, center: [1, 2, 3], width: 10, distance: 12, pivot: null, base: null,
};
const views = [view, { ...view, type: "perspective" as const, width: 0.8 }];
const pivot: Vec3 = [2, 1, 4];

test("axes are those of Python", () => {
  for (const { angles, axes } of fixtures.axes) {
    const found = camera.imageAxes(angles[0], angles[1], angles[2]);
    found.forEach((axis, i) => close(axis, axes[i]));
  }
});

test("angles of axes, and back", () => {
  for (const { angles } of fixtures.axes) {
    const axes = camera.imageAxes(angles[0], angles[1], angles[2]);
    const found = camera.anglesOf(axes, angles[1]);
    camera.imageAxes(found.incl, found.phi, found.posang).forEach((axis, i) => close(axis, axes[i]));
  }
  for (const { direction, angles } of fixtures.towards) {
    const d = direction as Vec3;
    const found = camera.anglesOf([[0, 0, 0], [0, 0, 0], d.map((v) => v / length(d)) as Vec3]);
    close([found.incl, found.phi], angles);
  }
});

test("the turntable follows the hand, stops at the pole, and keeps the position angle", () => {
  const level = { ...view, posang: 0, center: [0, 0, 0] as Vec3 };
  const front: Vec3 = camera.imageAxes(60, 30, 0)[2];
  const turned = camera.project(camera.orbit(level, 5, 0), front);
  assert.ok(turned.x > 0, "what is in front goes to the right");
  assert.ok(camera.project(camera.orbit(level, 0, 5), front).y > 0, "and up");
  assert.equal(camera.orbit(view, 0, -300).incl, 0);
  assert.equal(camera.orbit(view, 40, 0).posang, 20);
});

test("the trackball does not depend on the way", () => {
  for (const start of views) {
    const a: [number, number] = [-0.3, 0.2];
    const b: [number, number] = [0.4, 0.5];
    const c: [number, number] = [0.1, -0.6];
    const round = camera.trackball(camera.trackball(camera.trackball(start, a, b), b, c), c, a);
    camera.axesOf(round).forEach((axis, i) => close(axis, camera.axesOf(start)[i], 1e-7));
    const direct = camera.trackball(start, a, c);
    const bent = camera.trackball(camera.trackball(start, a, b), b, c);
    camera.axesOf(bent).forEach((axis, i) => close(axis, camera.axesOf(direct)[i], 1e-7));
  }
});

test("rotations leave the pivot where it is", () => {
  for (const start of views.map((v) => ({ ...v, pivot }))) {
    const before = camera.project(start, pivot);
    for (const next of [camera.orbit(start, 33, 12), camera.roll(start, 25), camera.trackball(start, [0, 0], [0.5, 0.3]), camera.fromSide(start, "x")]) {
      const after = camera.project(next, pivot);
      if (next.posang === start.posang && next.incl !== 90) close([after.x, after.y], [before.x, before.y], 1e-9);
      close([after.depth], [before.depth], 1e-6 + Math.abs(after.depth - before.depth));
      const arm = sub(next.center, pivot);
      close([length(arm)], [length(sub(start.center, pivot))]);
    }
  }
});

test("a roll turns the picture anticlockwise", () => {
  const level = { ...view, posang: 0 };
  const right = camera.axesOf(level)[0];
  const point = level.center.map((v, i) => v + right[i]) as Vec3;
  assert.ok(camera.project(camera.roll(level, 90), point).y > 0.09);
});

test("the zoom keeps the point under the pointer, panning moves with the hand", () => {
  for (const start of views) {
    const axes = camera.axesOf(start);
    const longer = camera.extent(start, 1)[0];
    const under = start.center.map((v, i) => v + 0.2 * longer * axes[0][i] - 0.3 * longer * axes[1][i]) as Vec3;
    const zoomed = camera.project(camera.zoom(start, 1.7, 0.2, -0.3), under);
    close([zoomed.x, zoomed.y], [0.2, -0.3]);
    const moved = camera.project(camera.pan(start, 0.1, 0.05), under);
    close([moved.x, moved.y], [0.3, -0.25]);
  }
});

test("a picture stands in for another one that was moved and zoomed", () => {
  for (const start of views) {
    const next = camera.zoom(camera.pan(start, 0.1, -0.2), 1.5, 0.3, 0.1);
    const axes = camera.axesOf(start);
    const longer = camera.extent(start, 1)[0];
    const point = start.center.map((v, i) => v + 0.1 * longer * axes[0][i] + 0.2 * longer * axes[1][i]) as Vec3;
    const from = camera.project(start, point);
    const to = camera.project(next, point);
    const { scale, x, y } = camera.standIn(start, next);
    close([scale * from.x + x, scale * from.y + y], [to.x, to.y]);
  }
});

test("perspective and parallel rays show as much at the center", () => {
  const there = camera.otherType(view);
  close(camera.extent(there, 1.5), camera.extent(view, 1.5));
  close([camera.otherType(there).width], [view.width]);
});

test("all of a domain is seen after a fit", () => {
  const bounds: [number, number][] = [[-1, 3], [0, 2], [5, 6]];
  for (const start of views) {
    for (const aspect of [0.5, 1, 2.2]) {
      const fitted = camera.fit(start, bounds, aspect);
      for (let i = 0; i < 8; i++) {
        const { x, y } = camera.project(fitted, bounds.map((b, k) => b[(i >> k) & 1]) as Vec3);
        assert.ok(Math.abs(x) <= Math.min(1, aspect) / 2 && Math.abs(y) <= Math.min(1, 1 / aspect) / 2);
      }
    }
  }
});

test("the view of a frame is the camera that drew it", () => {
  for (const start of views) {
    const axes = camera.axesOf(start);
    const table = camera.tableOf(start);
    const [width, height] = start.type === "perspective" ? [0.8, 0.4] : [10, 5];
    const position = start.type === "perspective" ? camera.positionOf(start) : null;
    const ahead = axes[2].map((v) => -v) as Vec3;
    const found = camera.viewOf(table, { center: start.center, right: axes[0], up: axes[1], ahead, width, height, shift: [0, 0], position });
    close([found.incl, found.phi, found.posang, found.width], [60, 30, 20, start.width], 1e-6);
    if (position) close([found.distance], [12]);
    if (table.up) assert.ok(Math.abs(dot(table.up as Vec3, axes[2])) < 1e-12);
  }
});

test("a table of a camera is read again", () => {
  for (const start of views) {
    const found = camera.viewFrom(camera.tableOf(start));
    close([found.incl, found.phi, found.posang, found.width], [60, 30, 20, start.width], 1e-6);
    close(found.center, start.center);
  }
});

test("a panorama turns where it is, and is neither moved nor zoomed", () => {
  const table = { type: "panorama", projection: "equirectangular", position: [1, 2, 3], target: [4, 2, 3], stereo: "over-under" };
  const inside = camera.viewFrom({ ...table, up: [0, 0, 1] });
  const turned = camera.orbit(inside, 90, 0);
  close(camera.positionOf(turned), table.position);
  assert.ok(Math.abs(length(sub(turned.center, table.position as Vec3)) - 3) < 1e-9);
  const told = camera.tableOf(turned);
  assert.deepEqual({ ...told, target: table.target, up: undefined }, { ...table, up: undefined });
  close(told.target, turned.center);
  for (const same of [camera.pan(inside, 0.1, 0.2), camera.zoom(inside, 2, 0, 0), camera.otherType(inside)]) assert.equal(same, inside);
  assert.equal(camera.sweep(inside), 360);
  assert.equal(camera.sweep(view), null);
});

test("a dome keeps its projection and its tilt while it is turned about its target", () => {
  const table = { type: "perspective", projection: "spherical", position: [5, 0, 0], target: [0, 0, 0], width: 1, zenith: 30, up: [0, 0, 1] };
  const { cos, sin } = { cos: Math.cos(Math.PI / 6), sin: Math.sin(Math.PI / 6) };
  const plane = { position: [5, 0, 0] as Vec3, center: [0, 0, 0] as Vec3, right: [0, 1, 0] as Vec3, up: [sin, 0, cos] as Vec3, ahead: [-cos, 0, sin] as Vec3, width: 1, height: 1, shift: [0, 0] as [number, number] };
  const told = camera.tableOf(camera.orbit(camera.viewOf(table, plane), 0, 0));
  close(told.position, table.position);
  close(told.up, table.up);
  assert.equal(told.zenith, 30);
});
