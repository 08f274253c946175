// Two results of one cloud beside each other, in place of before and after.

import { bytes, request } from "./api.js";
import { parse } from "./display.js";
import { inWords } from "./options.js";

const $ = (id) => document.getElementById(id);
const BINS = 64;

/** Return the other finished jobs, of the last hundred, of the same file, newest first. */
export async function others(job, signal) {
  const jobs = await (await request("jobs?limit=100", { signal })).json();
  const same = ["name", "format", "bytes", "points"];
  return jobs.filter((other) => other.id !== job.id && other.status === "succeeded" &&
    same.every((fact) => other.upload[fact] === job.upload[fact]));
}

/** What a choice of them is called: when, and what set it apart. */
export function title(job) {
  const time = new Date(job.finished_at).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return `${inWords(job.parameters)} (${time})`;
}

/** Whether two display files hold the same points in the same order, so that their results can be compared. */
export function comparable(display, other) {
  const [one, two] = [display, other].map(({ before }) => before.POSITION);
  return one.length === two.length && one.every((value, at) => value === two[at]);
}

function statistics(lengths) {
  const sorted = lengths.slice().sort();
  const at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
  const p99 = at(0.99);
  const histogram = new Array(BINS).fill(0);
  for (const length of lengths) if (length <= p99) histogram[Math.min(BINS - 1, Math.floor((length / (p99 || 1)) * BINS))]++;
  const mean = lengths.reduce((sum, length) => sum + length, 0) / lengths.length;
  return { mean, median: at(0.5), p95: at(0.95), p99, max: sorted.at(-1), histogram };
}

/** Return a display of `other`'s result before and `display`'s after; the displacement is the difference of the two. */
export function compared(display, other) {
  const [one, two] = [other, display].map(({ after }) => after.POSITION);
  const lengths = new Float32Array(display.shown);
  for (let index = 0; index < lengths.length; index++) {
    const at = index * 3;
    lengths[index] = Math.hypot(two[at] - one[at], two[at + 1] - one[at + 1], two[at + 2] - one[at + 2]);
  }
  return {
    ...display,
    against: true,
    before: { ...other.after, COLOR_0: display.before.COLOR_0 },
    after: { ...display.after, _DISPLACEMENT: lengths },
    displacement: statistics(lengths),
  };
}

/** The choice of what a result is compared with: the file as it came, or another result of it. */
export class Comparison {
  /** `show` is given the display to show and what its sides are called; `say` what went wrong. */
  constructor({ show, say }) {
    Object.assign(this, { show, say, against: "" });
    $("against").addEventListener("change", () => this.choose($("against").value));
  }

  /** Offer the other results of a job's file, and show the one that is wanted. */
  async offer(job, display, wanted, signal) {
    Object.assign(this, { display, signal, against: "" });
    const found = await others(job, signal);
    if (signal.aborted) return;
    $("against").replaceChildren(new Option("The file as it came", ""), ...found.map((other) => new Option(title(other), other.id)));
    $("comparison").hidden = !found.length;
    if (found.some(({ id }) => id === wanted)) await this.choose(wanted);
  }

  async choose(id) {
    $("against").value = id;
    if (!id) return this.now(id, this.display, ["Before", "After"]);
    try {
      const other = parse(await bytes(await request(`jobs/${id}/display`, { signal: this.signal }), () => {}));
      if (comparable(this.display, other)) {
        return this.now(id, compared(this.display, other), [$("against").selectedOptions[0].text, "This result"]);
      }
      this.say("The two results hold different points, so they cannot be compared.");
    } catch (error) {
      if (error.name === "AbortError") return;
      this.say(`${error.detail ?? error} ${error.hint ?? ""}`);
    }
    $("against").value = this.against;
  }

  now(id, display, names) {
    this.against = id;
    this.show(display, names);
  }
}
