// What three.js and loaders.gl find in a file: `node web.mjs three|loaders FILE` prints the arrays as JSON.
import { readFileSync } from "node:fs";

const [library, path] = process.argv.slice(2);
const bytes = readFileSync(path);
const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const ending = path.slice(path.lastIndexOf(".") + 1);

const plain = (attribute) => (attribute ? Array.from(attribute.array ?? attribute.value) : null);

async function three() {
  const { PLYLoader } = await import("three/addons/loaders/PLYLoader.js");
  const { PCDLoader } = await import("three/addons/loaders/PCDLoader.js");
  const parsed = ending === "ply" ? new PLYLoader().parse(data) : new PCDLoader().parse(data).geometry;
  const { position, normal, color, intensity } = parsed.attributes;
  return { points: plain(position), normals: plain(normal), colours: plain(color), intensity: plain(intensity) };
}

async function loaders() {
  const { parse } = await import("@loaders.gl/core");
  const { PLYLoader } = await import("@loaders.gl/ply");
  const { PCDLoader } = await import("@loaders.gl/pcd");
  const { LASLoader } = await import("@loaders.gl/las");
  const loader = { ply: PLYLoader, pcd: PCDLoader, las: LASLoader, laz: LASLoader }[ending];
  const { attributes } = await parse(data, loader, { worker: false, las: { fp64: true, colorDepth: "auto" } });
  return {
    points: plain(attributes.POSITION),
    normals: plain(attributes.NORMAL),
    colours: plain(attributes.COLOR_0),
    colourValues: attributes.COLOR_0?.size ?? 3,
    intensity: plain(attributes.intensity),
    classes: plain(attributes.classification),
  };
}

console.log(JSON.stringify(await (library === "three" ? three() : loaders())));
