#!/usr/bin/env bash
# One would expect: the packed `rgb` of a PCD, which PCL defines as 0x00RRGGBB in a float, is read as red, green, blue.
# What happens (@loaders.gl/pcd 4.4.2): the reader takes its three bytes in the order of the file, which on a
# little-endian machine is blue, green, red. three.js 0.187.0 reads the same file rightly.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-audit --no-fund --silent @loaders.gl/core@4.4.5 @loaders.gl/pcd@4.4.2 three@0.187.0
cat > read.mjs <<'NODE'
import { parse } from "@loaders.gl/core";
import { PCDLoader } from "@loaders.gl/pcd";
import { PCDLoader as ThreeLoader } from "three/addons/loaders/PCDLoader.js";

const head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 3\nHEIGHT 1\n" +
  "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA binary\n";
const data = new ArrayBuffer(head.length + 3 * 16);
new Uint8Array(data).set(new TextEncoder().encode(head));
const view = new DataView(data, head.length);
const [red, green, blue] = [200, 100, 50];
for (let row = 0; row < 3; row += 1) {
  [row, 2 * row, 1].forEach((value, axis) => view.setFloat32(16 * row + 4 * axis, value, true));
  view.setUint32(16 * row + 12, (red << 16) | (green << 8) | blue, true);
}
const found = Array.from((await parse(data, PCDLoader, { worker: false })).attributes.COLOR_0.value.slice(0, 3));
const linear = Array.from(new ThreeLoader().parse(data).geometry.attributes.color.array.slice(0, 3));
console.log("written as red green blue:", [red, green, blue]);
console.log("loaders.gl:", found, " three.js (linear, 0 to 1):", linear.map((value) => value.toFixed(3)));
const expected = found.join() === [blue, green, red].join() && linear[0] > linear[1] && linear[1] > linear[2];
if (!expected) console.error("the behaviour has changed");
process.exit(expected ? 0 : 1);
NODE
node read.mjs
