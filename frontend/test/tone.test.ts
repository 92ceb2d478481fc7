// Tones against `Image.to_rgb`, within one of 255 codes.

import assert from "node:assert/strict";
import { test } from "node:test";
import { bend, settle, toneOf, valueAt } from "../src/tone";
import fixtures from "./fixtures.json";

const tables = Object.fromEntries(Object.entries(fixtures.tones.tables).map(([name, table]) => [name, Uint8Array.from(table)]));

for (const { options, shown, values, rgb } of fixtures.tones.cases) {
  test(`${shown.channels} channels, ${JSON.stringify(options)}`, () => {
    const tone = settle(options, shown as any);
    values.forEach((intensity, i) => {
      const found = toneOf(intensity, tone, tables[tone.colormap ?? ""]);
      found.forEach((v, k) => assert.ok(Math.abs(v - rgb[i][k]) <= 1 / 255, `pixel ${i}: ${found} is not ${rgb[i]}`));
    });
  });
}

test("marks of a colour bar are where their values are", () => {
  for (const options of [{ stretch: "log" }, { stretch: "asinh" }, { stretch: "sqrt" }, { norm: "log" }]) {
    const tone = settle({ colormap: "gray", vmin: 0.01, vmax: 4, ...options }, { channels: 1, exposure: 1 });
    for (const w of [0.1, 0.5, 0.9]) {
      const value = valueAt(w, tone);
      const place = tone.logarithmic ? Math.log(value / 0.01) / Math.log(400) : bend((value - 0.01) / 3.99, tone);
      assert.ok(Math.abs(place - w) < 1e-9);
    }
  }
});
