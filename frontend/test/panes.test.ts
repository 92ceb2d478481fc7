// How slices lie on the screen, and where a cell is in what the server sends.

import assert from "node:assert/strict";
import { test } from "node:test";
import { lieOf, placeIn } from "../src/panes";

test("slices of a patient lie as radiologists have them, however the axes point", () => {
  // The sides at the right, left, upper and lower border.
  const letters = { Axial: "LRAP", Coronal: "LRSI", Sagittal: "PASI" };
  for (const code of ["LPS", "RAS", "PSL", "IRA"]) {
    const names = [0, 1, 2].map((axis) => {
      const { name, right, up, letters: told } = lieOf(axis, code, false);
      assert.equal(told.join(""), letters[name as keyof typeof letters]);
      for (const [[j, sense], letter] of [[right, told[0]], [up, told[2]]] as const) {
        assert.equal(code[j] === letter, sense > 0);
        assert.notEqual(j, axis);
      }
      return name;
    });
    assert.deepEqual(names.sort(), ["Axial", "Coronal", "Sagittal"]);
  }
});

test("elsewhere axes are as in the file, and stacks of pictures have y downwards", () => {
  assert.deepEqual(lieOf(2, "", false), { name: "", right: [0, 1], up: [1, 1], letters: [] });
  assert.deepEqual(lieOf(2, "", true).up, [1, -1]);
  assert.deepEqual([lieOf(1, "", true).right, lieOf(1, "", true).up], [[0, 1], [2, 1]]);
  assert.deepEqual([lieOf(0, "", false).right, lieOf(0, "", false).up], [[1, 1], [2, 1]]);
});

test("columns of a slice are along the next axis in turn, rows along the one after it", () => {
  const cell = [2, 3, 5];
  assert.equal(placeIn(0, 10, cell), 5 * 10 + 3);
  assert.equal(placeIn(1, 10, cell), 2 * 10 + 5);
  assert.equal(placeIn(2, 10, cell), 3 * 10 + 2);
});
