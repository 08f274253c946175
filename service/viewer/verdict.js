// What was done to a cloud, in plain words.

import { count } from "./numbers.js";
import { length, unitNote } from "./units.js";

const LITTLE = 0.15, STRONG = 1; // noise in spacings

/** A share as people read it: never 0 % or 100 % of a cloud where it is not. */
export function percent(share) {
  if (share === 0) return "none";
  if (share === 1) return "all";
  if (share < 0.0005) return "less than 0.1 %";
  if (share > 0.9995) return "more than 99.9 %";
  return `${(share * 100).toFixed(1)} %`;
}

/** The shares of points that were moved, left and moved doubtfully far; the last is unknown to older results. */
export function shares(display) {
  if (display.shares) return display.shares;
  const lengths = display.after._DISPLACEMENT;
  const moved = lengths.reduce((sum, moved) => sum + (moved > 0 ? 1 : 0), 0) / lengths.length;
  return { moved, left: 1 - moved, doubtful: null };
}

function ofNoise({ noise, spacing }) {
  if (noise === 0) return "No noise was found.";
  const strength = noise / spacing;
  const word = strength < LITTLE ? "little" : strength > STRONG ? "strong" : "moderate";
  const than = { little: "far less than", moderate: "less than", strong: "more than" }[word];
  return `There is ${word} noise: about ${length(noise)}, ${than} the ${length(spacing)} between points.`;
}

function ofPasses({ radii }) {
  const each = radii.map(length);
  if (each.length === 1) return `In one pass, each point was fitted to the surface within ${each[0]} of it.`;
  const last = each.pop();
  return `In ${radii.length} passes, each point was fitted to the surface within ${each.join(", ")} and then ${last} of it.`;
}

function ofMoves(display) {
  const { moved, left, doubtful } = shares(display);
  const { median, p95 } = display.displacement;
  const said = [];
  if (moved === 0) return ["Every point was left where it was."];
  const usual = `half of all by less than ${length(median)}, and 95 % by less than ${length(p95)}`;
  const subject = moved === 1 ? "All points were" : `Of ${count(display.points)} points, ${percent(moved)} were`;
  said.push(`${subject} moved: ${usual}.`);
  if (left > 0) said.push(`${sentence(percent(left))} were left where they were: the points around them do not show a surface, or they were excluded.`);
  if (doubtful > 0) {
    said.push(`${sentence(percent(doubtful))} were moved doubtfully far, by more than three times the noise around them. ` +
      "The colouring by displacement shows where.");
  }
  if (doubtful === 0) said.push("None was moved further than its noise explains.");
  return said;
}

const sentence = (text) => text[0].toUpperCase() + text.slice(1);

/** Sentences on a finished job and its display file, which may be missing. */
export function verdict(job, display) {
  const plan = job.execution?.plan;
  const said = [...(plan ? [ofNoise(plan), ofPasses(plan)] : []), ...(display ? ofMoves(display) : [])];
  if (said.length && unitNote()) said.push("Lengths are in the file's unit. Choose below which that is.");
  return said;
}
