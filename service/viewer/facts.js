// The table of figures beside the picture.

import { count, seconds } from "./numbers.js";
import { length, unitNote } from "./units.js";

/** Rows of [name, text, note] for a finished job and, where there is one, its display file. */
export function rows(job, display) {
  const points = [["Points", count(display?.points ?? job.upload.points),
    display && display.shown < display.points ? `${count(display.shown)} drawn` : ""]];
  const moved = display && [
    ["Displacement", "", unitNote()],
    ["mean", length(display.displacement.mean), ""],
    ["median", length(display.displacement.median), ""],
    ["95 %", length(display.displacement.p95), ""],
  ];
  const took = (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000;
  const { execution } = job;
  const passes = execution.plan?.radii.length;
  return [
    ...points,
    ...(moved ?? []),
    ["Time", seconds(took), passes ? `${passes} ${passes === 1 ? "pass" : "passes"}` : ""],
    ["Device", execution.device, execution.cpu_fallback ? "no GPU found" : ""],
    ["Model", execution.model, ""],
  ];
}

export function showNumbers(element, job, display) {
  element.replaceChildren(...rows(job, display).map(([name, text, note]) => {
    const row = document.createElement("div");
    const term = document.createElement("dt");
    term.textContent = name;
    const detail = document.createElement("dd");
    detail.textContent = text;
    if (["mean", "median", "95 %"].includes(name)) row.className = "part";
    if (note) {
      const small = document.createElement("small");
      small.textContent = note;
      detail.append(" ", small);
    }
    row.append(term, detail);
    return row;
  }));
}
