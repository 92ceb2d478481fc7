// Texts of clips, which Python reads; and what is drawn of them.

import assert from "node:assert/strict";
import { test } from "node:test";
import { type Clip, clipOf, depths, section, textOf, wholeOf } from "../src/clip";
import { dot, length, sub } from "../src/vec";

const bounds: [number, number][] = [[-1, 1], [0, 4], [-2e18, 2e18]];

test("a text is read as the clip that wrote it", () => {
  const whole = wholeOf(bounds);
  const clips: Clip[] = [
    { box: [[-0.5, 0, -2e18], [1, 3.25, 1e18]], plane: null },
    { ...whole, plane: { normal: [0.6, 0, 0.8], depth: 1e17 } },
    { box: [[-1, 0.5, -1e18], [0.25, 4, 2e18]], plane: { normal: [0, 1, 0], depth: 2 } },
  ];
  for (const clip of clips) {
    const again = clipOf(textOf(clip, bounds)!, bounds)!;
    assert.deepEqual(again.box, clip.box);
    assert.deepEqual(clipOf(`(${textOf(clip, bounds)})`, bounds), again);
    if (!clip.plane) assert.equal(again.plane, null);
    else {
      assert.ok(length(sub(again.plane!.normal, clip.plane.normal)) < 1e-5);
      // Points have the digits of sliders.
      assert.ok(Math.abs(again.plane!.depth - clip.plane.depth) < 1e-4 * (1 + Math.abs(clip.plane.depth)));
    }
  }
  assert.equal(textOf(clips[0], bounds), "box((-0.5, 0, -2e+18), (1, 3.25, 1e+18))");
  assert.equal(textOf(whole, bounds), null);
  for (const other of ["", "sphere((0, 0, 0), 1)", "~box((0, 0, 0), (1, 1, 1))", "box((0, 0, 0), (1 pc, 1 pc, 1 pc))"]) {
    assert.equal(clipOf(other, bounds), null);
  }
});

test("a plane cuts a cube in a hexagon across its diagonal", () => {
  const s = 3 ** -0.5;
  const cube: [number, number][] = [[0, 1], [0, 1], [0, 1]];
  const clip: Clip = { ...wholeOf(cube), plane: { normal: [s, s, s], depth: 1.5 * s } };
  const points = section(clip);
  assert.equal(points.length, 6);
  points.forEach((p, i) => {
    assert.ok(Math.abs(dot(p, clip.plane!.normal) - 1.5 * s) < 1e-12);
    // In order around the middle: sides of a regular hexagon.
    assert.ok(Math.abs(length(sub(p, points[(i + 1) % 6])) - 0.5 ** 0.5) < 1e-12);
  });
  assert.deepEqual(depths(cube, [0, -1, 0]), [-1, 0]);
  assert.deepEqual(section({ ...clip, plane: { normal: [1, 0, 0], depth: 2 } }), []);
});
