// Imports have no circle, those of types included: each file can be read after those that it names.

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { test } from "node:test";

const imported = (file: string) =>
  [...readFileSync(file, "utf8").matchAll(/^(?:import|export)[^;]*?["'](\.[^"']+)["'];/gm)].map(([, name]) => join(dirname(file), name.replace(/\.js$/, "") + ".ts"));

test("imports have no circle", () => {
  const files = readdirSync("src", { recursive: true }).map((name) => join("src", String(name))).filter((name) => name.endsWith(".ts"));
  const left = new Map(files.map((file) => [file, imported(file)]));
  assert.ok([...left.values()].flat().every((file) => left.has(file)));
  for (let done = 1; done; ) {
    const free = [...left].filter(([, names]) => !names.some((name) => left.has(name))).map(([file]) => file);
    done = free.length;
    for (const file of free) left.delete(file);
  }
  assert.deepEqual(Object.fromEntries(left), {});
});
