// The list of jobs that this key sent, or whoever the service takes callers without a key for: open, cancel, delete.

import { request } from "./api.js";
import { count } from "./numbers.js";

const $ = (id) => document.getElementById(id);
const PAGE = 20;
const AGES = [["day", 86400], ["hour", 3600], ["minute", 60], ["second", 1]];
const ago = new Intl.RelativeTimeFormat("en", { numeric: "auto" });

/** How long ago a time was, in words. */
export function age(time, now = Date.now()) {
  const seconds = Math.max(0, (now - Date.parse(time)) / 1000);
  const [unit, length] = AGES.find(([, least]) => seconds >= least) ?? AGES.at(-1);
  return ago.format(-Math.floor(seconds / length), unit);
}

/** The state of a job in a few words. */
export function stateOf({ status, progress, queue_position: place, problem }) {
  if (status === "queued") return place === 1 ? "next in the queue" : "waiting";
  if (status === "running") return `${Math.floor((progress.done / progress.total) * 100)} % done`;
  if (status === "failed") return problem.title.toLowerCase();
  return { cancelling: "stopping", cancelled: "cancelled", succeeded: "done" }[status];
}

function element(tag, values, ...children) {
  const made = Object.assign(document.createElement(tag), values);
  made.append(...children);
  return made;
}

export class Jobs {
  /** `gone` is told the id of a job that was deleted, `say` what goes wrong before the list is open. */
  constructor({ say, gone }) {
    this.gone = gone;
    this.say = (error) => {
      const text = `${error.detail ?? error} ${error.hint ?? ""}`;
      if ($("jobs-dialog").open) $("jobs-said").textContent = text;
      else say(text);
    };
    $("jobs").addEventListener("click", () => this.open());
    $("jobs-close").addEventListener("click", () => $("jobs-dialog").close());
    $("jobs-more").addEventListener("click", () => this.more());
    $("jobs-list").addEventListener("click", (event) => event.target.closest("a") && $("jobs-dialog").close());
  }

  async open() {
    $("jobs-list").replaceChildren();
    $("jobs-said").textContent = "";
    this.last = "";
    if (await this.more()) $("jobs-dialog").showModal();
  }

  /** Show the next page of jobs; returns whether the service gave one. */
  async more() {
    try {
      const query = `limit=${PAGE}${this.last && `&before=${this.last}`}`;
      const jobs = await (await request(`jobs?${query}`, { cache: "no-store" })).json();
      $("jobs-list").append(...jobs.map((job) => this.row(job)));
      this.last = jobs.at(-1)?.id ?? this.last;
      $("jobs-more").hidden = jobs.length < PAGE;
      $("jobs-none").hidden = $("jobs-list").children.length > 0;
      return true;
    } catch (error) {
      this.say(error);
      return false;
    }
  }

  row(job) {
    const name = `${job.upload.name ?? "cloud"}.${job.upload.format}`;
    const facts = [`${count(job.upload.points)} points`, stateOf(job), age(job.created_at)].join(" · ");
    const row = element("li", {},
      element("a", { href: `#/jobs/${job.id}`, textContent: name }),
      element("span", { className: "note", textContent: facts }));
    row.append(job.finished_at ? this.remover(job, name, row) : this.stopper(job, name, row));
    return row;
  }

  stopper(job, name, row) {
    const button = element("button", { type: "button", className: "secondary", textContent: "Cancel", ariaLabel: `Cancel ${name}` });
    button.addEventListener("click", () => this.ask(`jobs/${job.id}/cancel`, "POST", async () => {
      row.replaceWith(this.row(await (await request(`jobs/${job.id}`, { cache: "no-store" })).json()));
    }));
    return button;
  }

  /** A button that deletes a job with its result when it is pressed twice. */
  remover(job, name, row) {
    const button = element("button", { type: "button", className: "secondary", textContent: "Delete", ariaLabel: `Delete ${name}` });
    let sure = false;
    button.addEventListener("blur", () => {
      sure = false;
      Object.assign(button, { textContent: "Delete", ariaLabel: `Delete ${name}` });
    });
    button.addEventListener("click", () => {
      if (!sure) {
        sure = true;
        Object.assign(button, { textContent: "Really?", ariaLabel: `Really delete ${name} and its result?` });
        return;
      }
      this.ask(`jobs/${job.id}`, "DELETE", () => {
        (row.nextElementSibling ?? row.previousElementSibling)?.querySelector("a").focus();
        row.remove();
        $("jobs-none").hidden = $("jobs-list").children.length > 0;
        this.gone(job.id);
      });
    });
    return button;
  }

  /** Send a request and do what follows; a job that has changed meanwhile is said in the service's words. */
  async ask(path, method, then) {
    try {
      await request(path, { method });
      await then();
    } catch (error) {
      this.say(error);
    }
  }
}
