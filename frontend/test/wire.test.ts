// Messages and codecs against what Python writes.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fromCode, fromHalf, inflate, limitsOf, undifference } from "../src/half";
import { fromBase64, unpack } from "../src/wire";
import fixtures from "./fixtures.json";

test("a message of Python is read", () => {
  const data = fromBase64(fixtures.message);
  const { message, bytes } = unpack(data);
  assert.deepEqual(message, { kind: "frame", number: 7, text: "τ ≤ 1" });
  assert.deepEqual([...bytes], [0, 1, 2, 3, 4]);
});

test("what is no message is refused", () => {
  assert.throws(() => unpack(new Uint8Array(20)));
  assert.throws(() => unpack(fromBase64(fixtures.message).subarray(0, 20)));
});

test("float16 frames", async () => {
  const { width, height, channels, low, bytes, values } = fixtures.half;
  const halves = undifference(await inflate(fromBase64(bytes)), width, height, channels);
  assert.equal(halves.length, values.length);
  halves.forEach((bits, i) => assert.ok(Math.abs(fromHalf(bits) * 2 ** low - values[i]) <= 1e-5 * values[i]));
  assert.throws(() => undifference(new Uint8Array(3), width, height, channels));
});

test("special halves", () => {
  const pairs: [number, number][] = [[0, 0], [1, 2 ** -24], [0x3c00, 1], [0xc000, -2], [0x7bff, 65504], [0x7c00, Infinity]];
  for (const [bits, value] of pairs) assert.equal(fromHalf(bits), value);
  assert.ok(Number.isNaN(fromHalf(0x7e00)));
});

test("limits of a plane, of either sign and without pixels of no value", () => {
  const [none, minusTwo, minusOne, zero, one] = [0xfc00, 0xc000, 0xbc00, 0, 0x3c00];
  assert.deepEqual(limitsOf(Uint16Array.of(none, minusOne, minusTwo)).filter((_, i) => i !== 1), [-2, -1]);
  assert.deepEqual(limitsOf(Uint16Array.of(minusOne, zero, one)), [-1, 1, 1]);
  assert.deepEqual(limitsOf(Uint16Array.of(none, one)), [1, 1, 1]);
});

test("logarithmic previews", () => {
  const { low, high, values } = fixtures.log;
  values.forEach((value, code) => assert.ok(Math.abs(fromCode(code, { low, high, codec: "log-jpeg" }) - value) <= 1e-5 * value));
});
