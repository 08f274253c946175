// The card that shows how far a job is: upload, queue, denoising, drawing.

import { count, ordinal, seconds } from "./numbers.js";

const $ = (id) => document.getElementById(id);
const STEPS = ["upload", "queue", "denoise", "show"];

export class Progress {
  constructor() {
    this.live = $("live");
    this.told = "";
  }

  /** Begin with a file's name. */
  start(name) {
    $("busy-file").textContent = name;
    $("cancel").disabled = false;
    this.lost(null);
    for (const row of $("steps").children) row.querySelector("output").textContent = "";
  }

  upload(share) {
    const percent = Math.floor(share * 100);
    this.step("upload", share < 1 ? "Uploading" : "Checking the file", share < 1 ? share * 100 : null, `${percent} %`);
  }

  job(job) {
    $("busy-file").textContent = `${job.upload.name ?? "cloud"}.${job.upload.format}`;
    $("cancel").disabled = job.status === "cancelling";
    const left = job.seconds_left === null ? "" : `about ${seconds(Math.max(1, job.seconds_left))} left`;
    if (job.status === "queued") {
      const place = `${ordinal(job.queue_position)} in the queue`;
      this.step("queue", job.queue_position === 1 ? "Next in the queue" : place, null, ordinal(job.queue_position), left);
    } else if (job.status === "running") {
      const { done, total } = job.progress;
      const percent = Math.floor((done / total) * 100);
      const points = `${count(job.upload.points)} points`;
      this.step("denoise", points, (done / total) * 100, `${percent} %`, left);
    } else if (job.status === "cancelling") {
      this.step("denoise", "Stopping", null, "");
    }
  }

  /** Say that the service does not answer; null once it does again. */
  lost(problem) {
    $("busy-lost").textContent = problem ? `${problem.detail} Trying again for a minute; the job goes on meanwhile.` : "";
  }

  show(share) {
    this.step("show", "Loading the points", share * 100, `${Math.floor(share * 100)} %`);
  }

  /** Show one step; `percent` null stands for no measure of it. */
  step(name, text, percent, short, left = "") {
    const at = STEPS.indexOf(name);
    STEPS.forEach((step, index) => {
      const row = $("steps").children[index];
      row.dataset.is = index < at ? "done" : index === at ? "now" : "later";
      row.querySelector("output").textContent = index === at ? short : "";
      if (index === at) row.setAttribute("aria-current", "step");
      else row.removeAttribute("aria-current");
    });
    if (percent === null) $("progress").removeAttribute("value");
    else $("progress").value = percent;
    $("busy-text").textContent = text;
    $("busy-left").textContent = left;
    document.title = `${short ? `${short} ` : ""}${text} · PCDNF`;
    const spoken = percent === null ? `${text} ${left}` : `${name} ${Math.floor(percent / 10) * 10} %`;
    if (spoken !== this.told) this.live.textContent = this.told = spoken;
  }
}
