// The document: changes at once, confirmed later, never lost.

import assert from "node:assert/strict";
import { test } from "node:test";
import { applied, Store, valueAt, withValue } from "../src/store";
import { fresh, strengthened, strengthOf, totals } from "../src/media";
import { numberOf, pretty, prettyUnit, roundLength, ticks, likewise } from "../src/ui/format";

function store() {
  const sent: any[] = [];
  const later: (() => void)[] = [];
  let n = 0;
  const made = new Store((m) => sent.push(m), () => ++n, (callback) => later.push(callback));
  made.receive({ kind: "document", document: { medium: [{ opacity: 1 }, { opacity: 2 }], image: {} }, revision: 0, n: 0 });
  return { made, sent, tick: () => later.splice(0).forEach((callback) => callback()) };
}

test("paths", () => {
  const tree = { a: [{ b: 1 }, { b: 2 }] };
  assert.equal(valueAt(tree, "a.1.b"), 2);
  assert.equal(valueAt(tree, "a.7.b"), undefined);
  const next = withValue(tree, "a.0.b", 5);
  assert.equal(next.a[0].b, 5);
  assert.equal(tree.a[0].b, 1);
  assert.equal(next.a[1], tree.a[1]);
  assert.deepEqual(withValue(tree, "a.0", null).a, [{ b: 2 }]);
  assert.deepEqual(withValue({}, "image.exposure", 2), { image: { exposure: 2 } });
  assert.deepEqual(applied({ x: 1, y: 2 }, [["x", null], ["y", 3]]), { y: 3 });
});

test("moving changes are merged, the last goes at once", () => {
  const { made, sent, tick } = store();
  made.set([["medium.0.opacity", 3]], "opacity", true);
  made.set([["medium.0.opacity", 4]], "opacity", true);
  assert.equal(made.document.medium[0].opacity, 4);
  assert.equal(sent.length, 0);
  tick();
  made.set([["medium.0.opacity", 5]], "opacity");
  assert.deepEqual(sent.map((m) => [m.n, m.patch[0][1], m.moving]), [[1, 4, true], [2, 5, false]]);
});

test("an older document does not take back what was not confirmed", () => {
  const { made } = store();
  made.set([["medium.1.opacity", 7]], "opacity");
  made.receive({ kind: "document", document: { medium: [{ opacity: 9 }, { opacity: 2 }] }, revision: 1, n: 0 });
  assert.deepEqual(made.document.medium, [{ opacity: 9 }, { opacity: 7 }]);
  assert.ok(made.isAhead);
  made.receive({ kind: "document", document: { medium: [{ opacity: 9 }, { opacity: 6 }] }, revision: 2, n: 1 });
  assert.equal(made.document.medium[1].opacity, 6);
  assert.ok(!made.isAhead);
});

test("a refused change is taken back, and no later one", () => {
  const { made, sent } = store();
  made.set([["medium.0.opacity", -3]], "a");
  made.set([["medium.1.opacity", 4]], "b");
  made.show([["image.exposure", 2]]);
  made.forget(sent[0].n);
  assert.deepEqual(made.document, { medium: [{ opacity: 1 }, { opacity: 4 }], image: { exposure: 2 } });
  assert.ok(made.isAhead);
  made.forget(sent[1].n);
  assert.equal(made.document.medium[1].opacity, 2);
  assert.ok(!made.isAhead);
});

test("what was not confirmed is sent once more, as one change", () => {
  const { made, sent } = store();
  made.set([["medium.0.opacity", 3]], "a");
  made.set([["medium.1.opacity", 4]], "b");
  sent.length = 0;
  made.resend();
  assert.equal(sent.length, 1);
  assert.deepEqual(sent[0].patch, [["medium.0.opacity", 3], ["medium.1.opacity", 4]]);
});

test("what is only shown is not sent, and stays through documents", () => {
  const { made, sent } = store();
  made.show([["image.exposure", 2]]);
  made.receive({ kind: "document", document: { medium: [], image: { gamut: "clip" } }, revision: 1, n: 0 });
  assert.deepEqual(made.document.image, { gamut: "clip", exposure: 2 });
  assert.equal(sent.length, 0);
  made.set([["image.exposure", 3]], "exposure");
  assert.equal(sent.length, 1);
});

test("strength of media", () => {
  const shell = fresh("gaussian", "x", [0, 1], 0.5, "#ff0000");
  const document = { medium: [shell] };
  const stronger = applied(document, strengthened(shell, 0, 3, true)).medium[0];
  assert.equal(strengthOf(stronger), 3);
  assert.ok(Math.abs(stronger.color[0] / 3 - shell.color[0] / shell.opacity) < 1e-6);
  const surface = fresh("isosurface", "x", [0, 1], 0.5, "#ff0000");
  const thick = applied({ medium: [surface] }, strengthened(surface, 0, 2, true)).medium[0];
  assert.ok(Math.abs(strengthOf(thick) - 2) < 1e-4);
});

test("all media together, per length", () => {
  const shell = { type: "gaussian", expr: "x", center: 1, sigma: 0.1, color: [1, 0.5, 0], opacity: 2, path_length: "2 pc" };
  const table = { type: "table", expr: "x", values: [0, 1, 3], colors: [[0], [1], [3]], opacities: [0, 1, 3] };
  const maps = new Map<string, Uint8Array>();
  const found = totals([shell, table, { ...shell, hidden: true }, { ...shell, expr: "y" }], "x", [-5, 1, 2, 9], { "medium.1.path_length": 0.5 }, maps, 3, "pc")!;
  const near = (a: number[], b: number[]) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < 1e-9, `${a} is not ${b}`));
  near(found.alpha, [0, 1 + 2, 4, 6]);
  near(found.j[0], [0, 0.5 + 2, 4, 6]);
  near(found.j[2], [0, 0 + 2, 4, 6]);
  const au = totals([{ ...shell, path_length: "2 pc" }], "x", [1], {}, maps, 3, "au")!;
  assert.ok(Math.abs(au.alpha[0] * 206264.806 - 1) < 1e-6);
  assert.equal(totals([{ ...shell, path_length: "2 furlong" }], "x", [1], {}, maps, 3, "pc"), null);
});

test("numbers in print", () => {
  assert.equal(pretty(1.234e-20), "1.23×10⁻²⁰");
  assert.equal(pretty(-1e6), "−10⁶");
  assert.equal(pretty(0.25), "0.25");
  assert.equal(prettyUnit("1 / cm3"), "cm⁻³");
  assert.equal(prettyUnit("g / cm3"), "g cm⁻³");
  assert.equal(prettyUnit("dex(1 / cm3)"), "dex(cm⁻³)");
  assert.equal(roundLength(2.4e17, "cm").text, "0.05 pc");
  assert.equal(roundLength(7, "").text, "5");
  assert.deepEqual(ticks(0, 1, 5), [0, 0.2, 0.4, 0.6, 0.8, 1]);
  assert.equal(numberOf("3e4 pc"), 3e4);
  assert.equal(likewise("3e4 pc", 5), "5 pc");
});
