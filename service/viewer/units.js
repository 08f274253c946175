// The unit of the file's lengths, which no format tells: the person says it once, and lengths are shown in words.

import { value } from "./numbers.js";

const KEY = "pcdnf-unit";
const METRES = [["km", 1e3, 1e3], ["m", 1, 1], ["mm", 1e-3, 1e-4], ["µm", 1e-6, 0]]; // name, metres, from how many on
const inMetres = { mm: 1e-3, cm: 1e-2, m: 1, km: 1e3 };
export const UNITS = ["", ...Object.keys(inMetres), "in", "ft"];

let unit = "";
try {
  const chosen = localStorage.getItem(KEY);
  if (UNITS.includes(chosen)) unit = chosen;
} catch {
  // No storage: the unit is not remembered.
}

export const fileUnit = () => unit;

/** Set the unit of the file, one of UNITS; an empty text for one that nobody knows. */
export function setFileUnit(chosen) {
  unit = UNITS.includes(chosen) ? chosen : "";
  try {
    localStorage.setItem(KEY, unit);
  } catch {
    // Not remembered, then.
  }
}

/** A length of the file as people read it: to three digits, in a unit that suits its size. */
export function length(number) {
  if (!unit) return value(number);
  if (!(unit in inMetres)) return `${value(number)} ${unit}`;
  const metres = number * inMetres[unit];
  const size = Math.abs(metres);
  const [name, factor] = METRES.find(([, , least]) => size >= least);
  return size === 0 ? `0 ${unit}` : `${value(metres / factor)} ${name}`;
}

/** What stands after lengths that carry no unit. */
export const unitNote = () => (unit ? "" : "in the file's unit");
