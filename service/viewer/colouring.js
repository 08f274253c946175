// Colours of points: arrays of RGBA bytes for the stage, and what the scale beside it shows.

// Eleven stops of viridis and of plasma (both CC0, by N. Smith and S. van der Walt); between them straight lines.
const VIRIDIS = "440154 482475 414487 355f8d 2a788e 21918c 22a884 44bf70 7ad151 bddf26 fde725";
const PLASMA = "0d0887 41049d 6a00a8 8f0da4 b12a90 cc4778 e16462 f2844b fca636 fcce25 f0f921";

export const MAPS = { height: table(VIRIDIS), displacement: table(PLASMA) };
const SHADED = [146, 168, 198];

/** 256 colours between the stops, as a flat array of bytes. */
function table(stops) {
  const colours = stops.split(" ").map((hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  const bytes = new Uint8Array(256 * 3);
  for (let index = 0; index < 256; index++) {
    const at = (index / 255) * (colours.length - 1);
    const low = Math.min(Math.floor(at), colours.length - 2);
    for (let channel = 0; channel < 3; channel++) {
      bytes[index * 3 + channel] = colours[low][channel] + (at - low) * (colours[low + 1][channel] - colours[low][channel]);
    }
  }
  return bytes;
}

function mapped(count, map, low, high, value) {
  const colours = new Uint8Array(count * 4);
  const factor = high > low ? 255 / (high - low) : 0;
  for (let index = 0; index < count; index++) {
    const step = Math.max(0, Math.min(255, Math.round((value(index) - low) * factor)));
    colours[index * 4] = map[step * 3];
    colours[index * 4 + 1] = map[step * 3 + 1];
    colours[index * 4 + 2] = map[step * 3 + 2];
    colours[index * 4 + 3] = 255;
  }
  return colours;
}

function uniform(count, [red, green, blue]) {
  const colours = new Uint8Array(count * 4);
  new Uint32Array(colours.buffer).fill((255 << 24) | (blue << 16) | (green << 8) | red);
  return colours;
}

/** The size of each component of the normal: the same for a normal and its opposite. */
function directions(normals) {
  const colours = new Uint8Array(normals.length);
  for (let index = 0; index < normals.length; index++) colours[index] = index % 4 === 3 ? 255 : 2 * Math.abs(normals[index]);
  return colours;
}

/** Return { before, after, lit }: the bytes of both meshes, and whether light falls on them. */
export function coloured(display, colouring, up) {
  const { before, after, shown } = display;
  if (colouring === "file" && before.COLOR_0) return { before: before.COLOR_0, after: before.COLOR_0, lit: true };
  if (colouring === "height") {
    const [low, high] = heights(display, up);
    const { axis, sign } = along(up);
    const of = (mesh) => mapped(shown, MAPS.height, low, high, (index) => sign * mesh.POSITION[index * 3 + axis]);
    return { before: of(before), after: of(after), lit: true };
  }
  if (colouring === "displacement") {
    const both = mapped(shown, MAPS.displacement, 0, display.displacement.p99, (index) => after._DISPLACEMENT[index]);
    return { before: both, after: both, lit: false };
  }
  if (colouring === "normal") return { before: directions(before.NORMAL), after: directions(after.NORMAL), lit: false };
  const same = uniform(shown, SHADED);
  return { before: same, after: same, lit: true };
}

/** The number of the axis that points up, and -1 where its negative end does. */
export function along(up) {
  return { axis: "xyz".indexOf(up.at(-1)), sign: up.startsWith("-") ? -1 : 1 };
}

/** Lowest and highest height of the box of 1 to 99 per cent, measured upwards. */
export function heights({ box }, up) {
  const { axis, sign } = along(up);
  return [box[0][axis] * sign, box[1][axis] * sign].sort((a, b) => a - b);
}
