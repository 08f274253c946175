// Numbers as people read them, and the table of them beside the picture.

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

export const count = (number) => whole.format(number).replaceAll(",", " ");

/** A length of the file's unit, to three digits. */
export function value(number) {
  if (number === 0) return "0";
  const size = Math.abs(number);
  if (size >= 1e6 || size < 1e-4) return number.toExponential(2).replace("e+", "e");
  if (size >= 1000) return count(number);
  return number.toPrecision(3);
}

export function seconds(number) {
  if (number < 10) return `${number.toFixed(1)} s`;
  if (number < 90) return `${Math.round(number)} s`;
  if (number < 5400) return `${Math.round(number / 60)} min`;
  return `${(number / 3600).toFixed(1)} h`;
}

export function ordinal(number) {
  const ending = { one: "st", two: "nd", few: "rd", other: "th" };
  return `${number}${ending[new Intl.PluralRules("en", { type: "ordinal" }).select(number)]}`;
}

/** Rows of [name, text, note] for a finished job and, where there is one, its display file. */
export function rows(job, display) {
  const points = [["Points", count(display?.points ?? job.upload.points),
    display && display.shown < display.points ? `${count(display.shown)} drawn` : ""]];
  const moved = display && [
    ["Displacement", "", "in the file's unit"],
    ["mean", value(display.displacement.mean), ""],
    ["median", value(display.displacement.median), ""],
    ["95 %", value(display.displacement.p95), ""],
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
