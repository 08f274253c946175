// The download of a result in the format that is chosen.

import { key, request } from "./api.js";

const $ = (id) => document.getElementById(id);

/** Let the browser keep a blob as a file. */
export function keep(blob, name) {
  const anchor = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 60000);
}

export class Downloads {
  /** `say` tells what went wrong; `changed` is called when another format is chosen. */
  constructor({ say, changed }) {
    this.say = say;
    this.job = null;
    $("download").addEventListener("click", (event) => this.download(event));
    $("format").addEventListener("change", () => {
      this.offer();
      changed();
    });
  }

  /** Offer the result of a job in a format, at first in that of its upload. */
  show(job, format = "") {
    this.job = job;
    this.choose(job.upload.format);
    if ([...$("format").options].some(({ value }) => value === format)) this.choose(format);
    this.offer();
  }

  /** The format, where it is not that of the upload. */
  get format() {
    return $("format").value === this.job.upload.format ? "" : $("format").value;
  }

  /** Choose a format; one that not every service knows is known to this one, since the file came in it. */
  choose(format) {
    const known = [...$("format").options].some(({ value }) => value === format);
    if (!known) $("format").append(new Option(format.toUpperCase(), format));
    $("format").value = format;
  }

  offer() {
    $("download").href = `${this.job.links.result.slice(1)}?format=${$("format").value}`;
  }

  /** See that the file can be had, so that a problem is shown in words, then let the browser fetch it. */
  async download(event) {
    event.preventDefault();
    const anchor = event.currentTarget;
    if (anchor.ariaBusy === "true") return;
    anchor.ariaBusy = "true";
    const address = anchor.getAttribute("href");
    try {
      if (key()) { // which the browser would not send by itself
        const name = `${this.job.upload.name ?? "cloud"}_denoised.${$("format").value}`;
        keep(await (await request(address)).blob(), name);
      } else {
        await request(address, { headers: { Range: "bytes=0-0" }, cache: "no-store" });
        Object.assign(document.createElement("a"), { href: address, download: "" }).click();
      }
    } catch (error) {
      this.say(error.detail ? `${error.detail} ${error.hint ?? ""}` : String(error));
    } finally {
      anchor.ariaBusy = "false";
    }
  }
}
