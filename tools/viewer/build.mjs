// Bundles src/viewer.js with three.js into one script that needs no network, and lays three's licence beside it.
import { copyFileSync, statSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const assets = "../../src/screwpose/report/assets/";
await build({
  entryPoints: [here("src/viewer.js")],
  outfile: here(`${assets}viewer.js`),
  bundle: true,
  minify: true,
  format: "iife",
  globalName: "ScrewposeViewer",
  target: "es2021",
  charset: "ascii",
  legalComments: "inline",
});
copyFileSync(here("node_modules/three/LICENSE"), here(`${assets}three-LICENSE.txt`));
console.log(`viewer.js: ${Math.round(statSync(here(`${assets}viewer.js`)).size / 1000)} kB`);
