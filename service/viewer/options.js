// The options of a job as a form: those of `POST /denoise`, each with a line of help.

import { request } from "./api.js";

const AUTO = ["auto", "Automatic"];
const FIELDS = [
  { name: "model", label: "Model", help: "The network that denoises. Without a choice, the service's own.",
    choices: [["", "The service's own"]] },
  { name: "iterations", label: "Passes", help: "How often the cloud is gone over. More remove more noise, and take longer.",
    choices: [AUTO, ["1", "1"], ["2", "2"], ["3", "3"], ["4", "4"]] },
  { name: "radius", label: "Radius", help: "The surroundings that a point is fitted to. Larger removes more, and rounds details.",
    choices: [AUTO, ["length", "A length"], ["share", "A share"]], number: { length: "in the file's unit", share: "% of the diagonal" } },
  { name: "fast", label: "Speed", help: "Fast uses half as many neighbours: about 1.4 times as fast, a little less exact.",
    choices: [["false", "Exact"], ["true", "Fast"]] },
  { name: "outliers", label: "Outliers", help: "Points far from all others: kept, removed, or kept with a mark in a column of their own.",
    choices: [["keep", "Keep"], ["drop", "Remove"], ["mark", "Mark"]] },
  { name: "nonfinite", label: "Rows not finite", help: "NaN and infinity: returned in their places, removed, or a reason to refuse the file.",
    choices: [["keep", "Keep"], ["drop", "Remove"], ["reject", "Refuse"]] },
  { name: "orient", label: "Orientation", help: "Whether all normals are turned to one side of the surface.",
    choices: [["false", "As found"], ["true", "To one side"]] },
  { name: "format", label: "Format", help: "Of the download. Every other one can still be chosen beside the result.",
    choices: [["", "That of the file"]] },
];
const usual = ({ choices }) => choices[0][0];

function element(tag, values = {}, ...children) {
  const made = Object.assign(document.createElement(tag), values);
  made.append(...children);
  return made;
}

export class Options {
  /** Fill `host`; `prefix` keeps the ids of two forms apart. */
  constructor(host, prefix) {
    this.selects = {};
    this.numbers = {};
    this.notes = {};
    host.classList.add("options");
    host.append(...FIELDS.map((field) => this.row(field, `${prefix}-${field.name}`)));
    for (const { value, text } of document.getElementById("format").options) this.selects.format.add(new Option(text, value));
  }

  row({ name, label, help, choices, number }, id) {
    const select = element("select", { id, className: "secondary" });
    select.setAttribute("aria-describedby", `${id}-help`);
    select.append(...choices.map(([value, text]) => new Option(text, value)));
    this.selects[name] = select;
    const row = element("div", { className: "option" }, element("label", { htmlFor: id, textContent: label }), select);
    if (number) row.append(this.measure(name, select, number));
    row.append(element("p", { id: `${id}-help`, className: "note", textContent: help }));
    return row;
  }

  /** A number beside a choice that needs one. */
  measure(name, select, units) {
    const input = element("input", { type: "number", min: "0", step: "any", required: true, value: "4" });
    const note = element("span", { className: "note" });
    const line = element("span", { className: "measure", hidden: true }, input, note);
    this.numbers[name] = input;
    select.addEventListener("change", () => {
      line.hidden = !(select.value in units);
      note.textContent = units[select.value] ?? "";
      input.ariaLabel = `${name} ${note.textContent}`;
    });
    return line;
  }

  /** Ask the service once which models it has. */
  async models() {
    if (this.asked) return;
    this.asked = true;
    const select = this.selects.model;
    const wanted = select.value;
    const models = await (await request("models")).json();
    for (const known of [...select.options].slice(1)) known.remove();
    select.append(...models.map(({ name, default: own }) => new Option(own ? `${name} (usual)` : name, name)));
    select.value = wanted;
  }

  /** What is not as usual: { name: text }. The format is among it, though it is no parameter of a job. */
  get values() {
    const found = {};
    for (const field of FIELDS) {
      const { value } = this.selects[field.name];
      if (value !== usual(field)) found[field.name] = value;
    }
    const number = this.numbers.radius.value;
    if (found.radius === "share") found.radius = `${number}%`;
    if (found.radius === "length") found.radius = number;
    return found;
  }

  /** Show the parameters of a job. */
  set values(parameters) {
    for (const field of FIELDS) {
      const select = this.selects[field.name];
      const text = String(parameters[field.name] ?? usual(field));
      const known = [...select.options].some(({ value }) => value === text);
      if (!known && field.name !== "radius") select.add(new Option(text, text));
      select.value = text;
    }
    const radius = String(parameters.radius ?? "auto");
    if (radius !== "auto") {
      this.selects.radius.value = radius.endsWith("%") ? "share" : "length";
      this.numbers.radius.value = parseFloat(radius);
    }
    this.selects.radius.dispatchEvent(new Event("change"));
  }

  /** Whether all numbers are given; the first that is not is shown to the person. */
  check() {
    const { radius } = this.numbers;
    return radius.parentElement.hidden || radius.reportValidity();
  }
}

/** The parameters of a job that the form does not show; another job is not announced to the program that sent it. */
export function hidden(parameters) {
  const shown = new Set(FIELDS.map(({ name }) => name));
  return Object.fromEntries(Object.entries(parameters).filter(([name]) => !shown.has(name) && name !== "callback_url"));
}

/** What sets a job apart, in a few words: `fast, 2 passes`. */
export function inWords(parameters) {
  const words = {
    iterations: (value) => `${value} ${Number(value) === 1 ? "pass" : "passes"}`,
    radius: (value) => `radius ${value}`,
    fast: () => "fast",
    outliers: (value) => (value === "drop" ? "without outliers" : "outliers marked"),
    nonfinite: (value) => (value === "drop" ? "finite rows only" : ""),
    orient: () => "oriented",
  };
  const apart = FIELDS.filter((field) => field.name in words && String(parameters[field.name] ?? usual(field)) !== usual(field));
  const said = apart.map(({ name }) => words[name](parameters[name])).filter(Boolean);
  return [parameters.model, ...said].filter(Boolean).join(", ");
}
