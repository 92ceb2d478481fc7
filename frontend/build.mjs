// Bundles the page (committed, so that installing from a clone needs no Node), or its tests.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { copyFileSync, readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const out = "../src/voluminous/viewer/static/";
const common = { bundle: true, format: "esm", target: "es2022", logLevel: "warning" };

if (process.argv.includes("--tests")) {
  const tests = readdirSync("test").filter((name) => name.endsWith(".test.ts"));
  await build({
    ...common,
    entryPoints: tests.map((name) => `test/${name}`),
    outdir: ".built",
    outExtension: { ".js": ".mjs" },
    platform: "node",
  });
} else {
  // Two modules: the page brings the connection, the explorer is the same in a notebook.
  const shared = { ...common, minify: true, legalComments: "none" };
  await build({ ...shared, entryPoints: ["src/explorer.ts"], outfile: out + "explorer.js" });
  await build({
    ...shared,
    entryPoints: ["src/page.ts"],
    outfile: out + "page.js",
    external: ["./explorer.js"],
  });
  await build({ ...shared, entryPoints: ["src/explorer.css"], outfile: out + "explorer.css" });
  for (const name of ["index.html", "icon.svg"]) copyFileSync(`src/${name}`, out + name);
  // A test compares both with what is there: a bundle that is older than its sources is found.
  const hashes = { sources: hashed("src/"), bundle: hashed(out) };
  writeFileSync("bundle.json", JSON.stringify(hashes, null, 2) + "\n");
  let total = 0;
  for (const name of readdirSync(out)) total += gzipSync(readFileSync(out + name)).length;
  console.log(`${(total / 1024).toFixed(1)} KiB compressed`);
  if (total > 70 * 1024) process.exitCode = 1;
}

/** SHA-256 of all files of a folder: name, zero, content, in the order of their names. */
function hashed(folder) {
  const names = readdirSync(folder, { recursive: true }).filter((name) => statSync(folder + name).isFile());
  const hash = createHash("sha256");
  for (const name of names.sort()) hash.update(name).update("\0").update(readFileSync(folder + name));
  return hash.digest("hex");
}
