// A scene as a link: everything that makes the picture, nothing else.

import assert from "node:assert/strict";
import { test } from "node:test";
import { linkOf, sceneOf } from "../src/share";

const scene = { medium: [{ type: "gaussian", expr: "log10(ρ)", color: [1, 0.5, 0] }], camera: { type: "orthographic", incl: 60 }, render: {}, image: { exposure: 2 } };

test("a link holds the scene, but neither volume nor views", async () => {
  const link = await linkOf({ ...scene, volume: { path: "secret.h5" }, bookmarks: [{ key: 1, camera: {} }] }, "http://host/");
  assert.match(link, /^http:\/\/host\/#scene=[\w-]+$/);
  assert.deepEqual(await sceneOf(link), scene);
  assert.deepEqual(await sceneOf(`#token=abc&${link.split("#")[1]}`), scene);
});

test("what is no link is none, and a broken one is refused", async () => {
  assert.equal(await sceneOf("[camera]\nincl = 60 # not a #scene=abc"), null);
  await assert.rejects(sceneOf("#scene=abcd"), /no link/);
});
