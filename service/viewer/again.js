// "Run again with …": the file of a job, sent once more with other options.

import { Options, hidden } from "./options.js";

const $ = (id) => document.getElementById(id);
const HELD = 4; // files that the page holds on to

export class Again {
  /** `run` is given a file and its options; `pick` asks the person for a file and calls back with it. */
  constructor({ run, pick, fail }) {
    this.files = new Map(); // of this visit, by job
    this.options = new Options($("again-options"), "again");
    const dialog = $("again-dialog");
    $("again-cancel").addEventListener("click", () => dialog.close());
    $("again-form").addEventListener("submit", (event) => {
      event.preventDefault();
      if (!this.options.check()) return;
      dialog.close();
      const file = this.files.get(this.job.id);
      const values = { ...hidden(this.job.parameters), ...this.options.values };
      if (file) run(file, values);
      else pick((chosen) => run(chosen, values));
    });
    this.fail = fail;
  }

  /** Hold the file of a job. */
  hold(id, file) {
    this.files.set(id, file);
    if (this.files.size > HELD) this.files.delete(this.files.keys().next().value);
  }

  /** Ask with what options the file of a job is to run again. */
  async show(job, format) {
    this.job = job;
    try {
      await this.options.models();
    } catch (error) {
      return this.fail(error);
    }
    this.options.values = { ...job.parameters, format };
    const name = `${job.upload.name ?? "cloud"}.${job.upload.format}`;
    $("again-file").textContent = this.files.has(job.id)
      ? `${name} is sent again. This result stays, and the two can be compared.`
      : `The page no longer holds ${name}. You choose it again, and the two results can be compared.`;
    $("again-run").textContent = this.files.has(job.id) ? "Run again" : "Choose the file";
    $("again-dialog").showModal();
  }
}
