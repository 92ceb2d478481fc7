// Lengths are shown in one unit, which suits the size of the volume in its field.

import { test } from "node:test";
import assert from "node:assert/strict";
import { lengthsShownIn, prettyLength, prettyPoint, roundLength, showLengthsIn, unitsFor } from "../src/ui/format";

test("a volume's size says the unit of its field", () => {
  const usual = (extent: number, unit: string) => unitsFor(extent, unit).usual;
  assert.equal(usual(245, "mm"), "mm"); // a head
  assert.equal(usual(1800, "mm"), "cm"); // a body
  assert.equal(usual(25, "um"), "µm"); // a cell
  assert.equal(usual(900, "um"), "µm"); // an embryo
  assert.equal(usual(120, "Angstrom"), "nm"); // a virus
  assert.equal(usual(3e17, "cm"), "pc"); // a core
  assert.equal(usual(200, "AU"), "au"); // a disc
  assert.equal(usual(30, "kpc"), "kpc");
  assert.equal(usual(1e5, "kpc"), "Mpc");
  assert.deepEqual(unitsFor(2, ""), { names: [], usual: "" });
  assert.deepEqual(unitsFor(2, "deg"), { names: [], usual: "" });
});

test("all lengths of a page are in one unit", () => {
  showLengthsIn("mm", "cm");
  assert.equal(lengthsShownIn("mm"), "cm");
  assert.equal(prettyLength(245, "mm"), "24.5 cm");
  assert.equal(prettyPoint([1, 20, -300], "mm"), "0.1, 2, −30 cm");
  assert.deepEqual(roundLength(0.7, "mm"), { length: 0.5, text: "0.05 cm" });
  // Another volume beside it keeps its own.
  assert.equal(prettyLength(2, "kpc"), "2 kpc");
});
