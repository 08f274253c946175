#!/usr/bin/env bash
# One would expect: the 8-bit colours of a PLY are the same after PLYLoader and Color.getRGB / SRGB, as they are with
# PCDLoader of the same package.
# What happens (three 0.187.0): PLYLoader makes them linear and stores them as 8 bits again, so dark colours fall
# together: 256 levels become fewer than 200, off by up to 6 of 255. PCDLoader keeps floats and all levels.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --no-audit --no-fund --silent three@0.187.0
cat > read.mjs <<'NODE'
import { Color, REVISION, SRGBColorSpace } from "three";
import { PCDLoader } from "three/addons/loaders/PCDLoader.js";
import { PLYLoader } from "three/addons/loaders/PLYLoader.js";

const levels = Array.from({ length: 256 }, (_, level) => level);
const ply = "ply\nformat ascii 1.0\nelement vertex 256\nproperty float x\nproperty float y\nproperty float z\n" +
  "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n" +
  levels.map((level) => `${level} 0 0 ${level} ${level} ${level}\n`).join("");
const pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 256\nHEIGHT 1\n" +
  "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 256\nDATA ascii\n" +
  levels.map((level) => `${level} 0 0 ${level * 0x010101}\n`).join("");
const colour = new Color();
function check(name, attribute) {
  const found = levels.map((level) => {
    colour.setRGB(attribute.getX(level), attribute.getY(level), attribute.getZ(level));
    return colour.getRGB({}, SRGBColorSpace).r * 255;
  });
  const off = Math.max(...levels.map((level) => Math.abs(found[level] - level)));
  const distinct = new Set(found.map((value) => value.toFixed(3))).size;
  console.log(`${name}: ${attribute.array.constructor.name}, ${distinct} levels, off by up to ${off.toFixed(2)} of 255`);
  return { off, distinct };
}
console.log("three", REVISION);
const fromPly = check("PLYLoader", new PLYLoader().parse(ply).getAttribute("color"));
const fromPcd = check("PCDLoader", new PCDLoader().parse(new TextEncoder().encode(pcd).buffer).geometry.getAttribute("color"));
const expected = fromPly.off > 2 && fromPly.distinct < 200 && fromPcd.off < 0.5 && fromPcd.distinct === 256;
if (!expected) console.error("the behaviour has changed");
process.exit(expected ? 0 : 1);
NODE
node read.mjs
