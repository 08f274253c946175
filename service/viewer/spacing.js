// How far apart the points of a cloud are, around each of them: the size at which they close a surface.

const BITS = 10; // of each axis: the finest cell is a thousandth of the cloud
const ENOUGH = 48; // points in the cell that measures
const FINER = 2; // levels between that cell and those that measure how much of it is surface
const WIDEST = 2; // in medians: a point that stands alone is no large disc

/** Spread the ten lowest bits of a number to every third bit. */
function spread(value) {
  let bits = value;
  bits = (bits | (bits << 16)) & 0x030000ff;
  bits = (bits | (bits << 8)) & 0x0300f00f;
  bits = (bits | (bits << 4)) & 0x030c30c3;
  return (bits | (bits << 2)) & 0x09249249;
}

/** Return the cells of points (N * 3), sorted along a Morton curve, as code * N + index; and the edge of all cells. */
function sortedCells(points) {
  const count = points.length / 3;
  const low = [points[0], points[1], points[2]];
  let edge = 0;
  for (let axis = 0; axis < 3; axis++) {
    let high = low[axis];
    for (let at = axis; at < points.length; at += 3) {
      const value = points[at];
      if (value < low[axis]) low[axis] = value;
      else if (value > high) high = value;
    }
    edge = Math.max(edge, high - low[axis]);
  }
  edge = edge * 1.0001 || 1;
  const scale = 2 ** BITS / edge;
  const cells = new Float64Array(count);
  for (let index = 0; index < count; index++) {
    const x = Math.floor((points[index * 3] - low[0]) * scale);
    const y = Math.floor((points[index * 3 + 1] - low[1]) * scale);
    const z = Math.floor((points[index * 3 + 2] - low[2]) * scale);
    cells[index] = (spread(x) | (spread(y) << 1) | (spread(z) << 2)) * count + index;
  }
  return { cells: cells.sort(), edge };
}

/**
 * Return the spacing (N) around each of N points (N * 3): the side of the square of surface that a point stands for.
 *
 * The smallest cell of an octree with enough points measures it: the surface in it is the number of its filled finer
 * cells times their side squared.
 */
export function spacings(points) {
  const count = points.length / 3;
  const found = new Float32Array(count);
  const { cells, edge } = sortedCells(points);
  const codes = Uint32Array.from(cells, (cell) => Math.floor(cell / count));
  const measured = (start, end, level) => {
    const finer = Math.min(BITS, level + FINER);
    const shift = 3 * (BITS - finer);
    let filled = 0;
    for (let at = start, last = -1; at < end; at++) {
      const cell = codes[at] >>> shift;
      if (cell !== last) filled++;
      last = cell;
    }
    return (edge / 2 ** finer) * Math.sqrt(filled / (end - start));
  };
  const descend = (start, end, level) => {
    const shift = 3 * (BITS - level - 1);
    let spacing = 0;
    for (let from = start, to = start; from < end; from = to) {
      if (level === BITS) to = end;
      while (to < end && codes[to] >>> shift === codes[from] >>> shift) to++;
      if (to - from >= ENOUGH && level < BITS) {
        descend(from, to, level + 1);
        continue;
      }
      spacing ||= measured(start, end, level);
      for (let at = from; at < to; at++) found[cells[at] - codes[at] * count] = spacing;
    }
  };
  descend(0, count, 0);
  const widest = WIDEST * found.slice().sort()[count >> 1];
  return found.map((spacing) => Math.min(spacing, widest));
}
