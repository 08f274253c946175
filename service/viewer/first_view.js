// The first look at a cloud: which axis is up, and from which side most of it is seen.

export const AXES = {
  x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1], "-x": [-1, 0, 0], "-y": [0, -1, 0], "-z": [0, 0, -1],
};
const SAMPLE = 20_000; // points that are looked at; any prefix of a display file is a fair sample
const FARTHEST_SENSOR = 20; // in radii of the cloud
const ONE_DEPTH = 0.8; // the share of directions with one depth, in what one sensor saw
const PER_CELL = 8; // points for each direction
const STEEPEST = 6; // how deep a surface may be in one direction, in widths of it
const FLAT = 0.94; // the cosine of a normal that is along an axis
const FLOOR = 0.04; // the share of points in a floor that decides which axis is up
const STEPS = 12; // directions around the cloud that are tried
const CELLS = 40; // of the picture that measures them
const USUAL = 0.06; // by how much another side must be better than the usual one

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, factor) => a.map((value) => value * factor);
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));

/** Two unit vectors across a direction. */
function across(direction, up = Math.abs(direction[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0]) {
  const right = unit(cross(up, direction));
  return [right, cross(direction, right)];
}

/**
 * Return the direction from the cloud to the sensor, if the origin of the file is where one sensor saw the cloud from:
 * outside the cloud, with one depth in nearly every direction. Null otherwise.
 */
export function sensorSide({ box, centre, after }) {
  const radius = Math.hypot(...box[0].map((low, axis) => box[1][axis] - low)) / 2;
  const distance = Math.hypot(...centre);
  const inside = centre.every((value, axis) => -value > box[0][axis] && -value < box[1][axis]);
  if (inside || distance < radius / 10 || distance > radius * FARTHEST_SENSOR) return null;
  const forward = unit(centre);
  const [right, above] = across(forward);
  const seen = [];
  let reach = 0;
  const count = Math.min(SAMPLE, after.POSITION.length / 3);
  for (let index = 0; index < count; index++) {
    const ray = [0, 1, 2].map((axis) => after.POSITION[index * 3 + axis] + centre[axis]);
    const depth = dot(ray, forward);
    if (depth <= 0) return null;
    const [u, v] = [dot(ray, right) / depth, dot(ray, above) / depth];
    if (Math.max(Math.abs(u), Math.abs(v)) > 2) continue; // far to the side: nothing that one camera sees
    seen.push([u, v, depth]);
    reach = Math.max(reach, Math.abs(u), Math.abs(v));
  }
  return oneDepth(seen, reach) >= ONE_DEPTH ? scaled(forward, -1) : null;
}

/** The share of directions in which the depths of [u, v, depth] are those of one surface. */
function oneDepth(seen, reach) {
  const cells = Math.max(8, Math.round(Math.sqrt(seen.length / PER_CELL)));
  const depths = new Map();
  for (const [u, v, depth] of seen) {
    const [column, row] = [u, v].map((value) => Math.floor(((value / reach + 1) / 2) * cells));
    const at = row * (cells + 1) + column;
    if (!depths.has(at)) depths.set(at, []);
    depths.get(at).push(depth);
  }
  const full = [...depths.values()].filter((cell) => cell.length >= 4);
  const single = full.filter((cell) => {
    const nearest = Math.min(...cell);
    return Math.max(...cell) - nearest < STEEPEST * nearest * ((2 * reach) / cells);
  });
  return full.length ? single.length / full.length : 0;
}

/** What is up for one sensor: cameras look along Z with Y down, or against it with Y up; scanners have Z up. */
function upOfSensor(side) {
  const [x, y, z] = side;
  if (Math.abs(z) < Math.max(Math.abs(x), Math.abs(y))) return "z";
  return z < 0 ? "-y" : "y";
}

/** Z, or Y where the lowest tenth along Y is a floor and that along Z is not. */
export function upAxis({ box, after }) {
  const count = Math.min(SAMPLE, after.POSITION.length / 3);
  const [alongY, alongZ] = [1, 2].map((axis) => {
    const edge = box[0][axis] + (box[1][axis] - box[0][axis]) / 10;
    let floor = 0;
    for (let index = 0; index < count; index++) {
      const flat = Math.abs(after.NORMAL[index * 4 + axis]) > FLAT * 127;
      if (flat && after.POSITION[index * 3 + axis] < edge) floor++;
    }
    return floor / count;
  });
  return alongY > FLOOR && alongY > 2 * alongZ ? "y" : "z";
}

/** How much of the cloud is seen from a direction, and how squarely: filled cells times the cosine of their normals. */
function seenFrom(direction, up, { after }, radius) {
  const [right, above] = across(direction, up);
  const nearest = new Float32Array(CELLS * CELLS).fill(-Infinity);
  const facing = new Float32Array(CELLS * CELLS);
  const point = [0, 0, 0];
  const count = Math.min(SAMPLE / 2, after.POSITION.length / 3);
  for (let index = 0; index < count; index++) {
    for (let axis = 0; axis < 3; axis++) point[axis] = after.POSITION[index * 3 + axis];
    const column = Math.floor((dot(point, right) / radius + 1) * 0.5 * CELLS);
    const row = Math.floor((dot(point, above) / radius + 1) * 0.5 * CELLS);
    if (column < 0 || row < 0 || column >= CELLS || row >= CELLS) continue;
    const at = row * CELLS + column;
    const depth = dot(point, direction);
    if (depth < nearest[at]) continue;
    nearest[at] = depth;
    for (let axis = 0; axis < 3; axis++) point[axis] = after.NORMAL[index * 4 + axis] / 127;
    facing[at] = Math.abs(dot(point, direction));
  }
  return facing.reduce((sum, value) => sum + value, 0);
}

/** The best of some directions around the cloud, a third of a right angle above it. */
function bestSide(display, up) {
  const radius = Math.hypot(...display.box[0].map((low, axis) => display.box[1][axis] - low)) / 2;
  const [right, ahead] = across(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1]);
  let [best, most] = [null, 0];
  for (let step = 0; step < STEPS; step++) {
    const turn = (step / STEPS) * 2 * Math.PI + Math.PI / 4; // along no axis: faces of a box would hide its depth
    const direction = unit([0, 1, 2].map((axis) =>
      Math.cos(turn) * right[axis] + Math.sin(turn) * ahead[axis] + 0.62 * up[axis]));
    const seen = seenFrom(direction, up, display, radius) * (step === 0 ? 1 + USUAL : 1);
    if (seen > most) [best, most] = [direction, seen];
  }
  return best ?? up;
}

/** Return { up, direction }: a key of AXES, and the direction from the cloud to the camera in the file's axes. */
export function firstView(display) {
  const side = sensorSide(display);
  if (side) return { up: upOfSensor(side), direction: side };
  const up = upAxis(display);
  return { up, direction: bestSide(display, AXES[up]) };
}

/** Return the direction to the camera once another axis is up: that of the sensor, or the best one above the cloud. */
export function sideFor(display, up) {
  return sensorSide(display) ?? bestSide(display, AXES[up]);
}
