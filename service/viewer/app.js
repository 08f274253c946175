// The page: a file becomes a job, a job becomes a picture. The address `#/jobs/ID` opens a job again.

import { read, write } from "./address.js";
import { Again } from "./again.js";
import { Problem, bytes, follow, onKeyNeeded, request, submit } from "./api.js";
import { Comparison } from "./comparison.js";
import { Controls } from "./controls.js";
import { parse } from "./display.js";
import { Downloads, keep } from "./downloads.js";
import { askForKey } from "./key_dialog.js";
import { showNumbers } from "./facts.js";
import { Jobs } from "./jobs.js";
import { installKeys } from "./keys.js";
import { Options } from "./options.js";
import { Progress } from "./progress.js";
import { Stage } from "./stage.js";
import { UNITS, fileUnit, setFileUnit } from "./units.js";
import { verdict } from "./verdict.js";

const $ = (id) => document.getElementById(id);
const root = document.documentElement;
const progress = new Progress();
let controls = null; // there where the browser has WebGL
let work = new AbortController(); // what the page is doing now
let current = null; // the job that is followed or shown
let retry = null; // what the problem's first button does
let tell = () => {}; // shows the figures of the result again, after a change of the unit
let picked = null; // what is done with the next file that is chosen, in place of the usual
const options = new Options($("options"), "first");
const downloads = new Downloads({ say, changed: remember });
const comparison = new Comparison({ say, show: (display, names) => {
  controls.load(display, controls.look);
  controls.name(names);
  remember();
} });
const again = new Again({ run: upload, fail, pick: (then) => {
  picked = then;
  $("input").click();
} });

new Jobs({ say, gone: (id) => id === current?.id && leave() });

const state = (name) => (root.dataset.state = name);

function say(text) {
  const toast = $("toast");
  toast.textContent = text;
  toast.classList.add("shown");
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => toast.classList.remove("shown"), 5000);
}

const paragraph = (textContent) => Object.assign(document.createElement("p"), { textContent });

function announce(text) {
  $("live").textContent = text;
}

/** Stop what the page was doing and return the signal of what it does next. */
function begin() {
  work.abort();
  work = new AbortController();
  return work.signal;
}

function home() {
  begin();
  current = null;
  name("");
  document.title = "PCDNF: denoise a point cloud";
  state("empty");
}

function fail(error, again = null) {
  if (error.name === "AbortError") return;
  const problem = error instanceof Problem ? error : new Problem({
    title: "The page met an error of its own", detail: String(error), hint: "Reload the page.", code: "page_error" });
  retry = again;
  $("problem-title").textContent = problem.title;
  $("problem-detail").textContent = problem.detail;
  $("problem-hint").textContent = problem.hint ?? "";
  $("problem-code").textContent = problem.code;
  $("problem-retry").hidden = !again;
  $("problem-pick").className = again ? "secondary" : "primary";
  document.title = `${problem.title} · PCDNF`;
  state("problem");
  $("problem-title").focus();
}

async function upload(file, { format = "", ...parameters } = options.values) {
  const signal = begin();
  current = null;
  name(file.name);
  progress.start(file.name);
  progress.upload(0);
  state("busy");
  try {
    const job = await submit(file, { parameters, progress: (share) => progress.upload(share), signal });
    if (signal.aborted) return;
    again.hold(job.id, file);
    history.pushState(null, "", write(job.id, { format }));
    await open(job.id);
  } catch (error) {
    const passing = error.code === "connection_lost" || error.status >= 500;
    fail(error, passing ? () => upload(file, { format, ...parameters }) : null);
  }
}

async function open(id) {
  const signal = begin();
  comparison.against = "";
  current = { id };
  progress.start("");
  progress.step("queue", "Asking for the job", null, "");
  state("busy");
  try {
    const seen = (job) => {
      current = job;
      name(fileName(job));
      progress.job(job);
    };
    const job = await follow(id, { seen, lost: (problem) => progress.lost(problem), signal });
    if (job.status === "succeeded") await show(job, signal);
    else if (job.status === "failed") throw new Problem(job.problem);
    else throw new Problem({ title: "Cancelled", detail: "The job was cancelled.", hint: "Its upload was removed." });
  } catch (error) {
    if (!signal.aborted) fail(error, error.code === "connection_lost" ? () => open(id) : null);
  }
}

function name(text) {
  for (const id of ["file-name", "subject"]) $(id).textContent = text;
  $("file-name").title = text;
}

const fileName = ({ upload }) => `${upload.name ?? "cloud"}.${upload.format}`;

async function show(job, signal) {
  let display = null;
  progress.show(0);
  if (controls) {
    try {
      const response = await request(job.links.display.slice(1), { signal });
      display = parse(await bytes(response, (share) => progress.show(share)));
    } catch (error) {
      if (error.code !== "display_not_found") throw error;
      say(`${error.detail} ${error.hint}`);
    }
  }
  state("result");
  $("stage").dataset.drawing = String(display !== null);
  const { look } = read(location.hash);
  downloads.show(job, look.format);
  $("comparison").hidden = true;
  if (display) {
    controls.load(display, look);
    controls.name(["Before", "After"]);
    comparison.offer(job, display, look.against, signal).catch((error) => say(String(error.detail ?? error)));
  }
  tell = () => {
    showNumbers($("numbers"), job, display);
    $("verdict").replaceChildren(...verdict(job, display).map((text) => paragraph(text)));
    controls?.scale();
  };
  tell();
  const expires = new Date(job.expires_at);
  $("kept").textContent = `Full precision. Kept until ${expires.toLocaleString([], { dateStyle: "medium", timeStyle: "short" })}.`;
  $("warnings").replaceChildren(...job.warnings.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  document.title = `${fileName(job)} · PCDNF`;
  announce("The result is shown.");
}

async function cancel() {
  const { id, links } = current ?? {};
  if (!id || !links) return home(); // still uploading: leaving ends it
  $("cancel").disabled = true;
  try {
    await request(`jobs/${id}/cancel`, { method: "POST" });
  } catch (error) {
    // A job that has just finished shows its result, which cancelling never removes.
    if (error.status !== 404 && error.code !== "already_finished") fail(error);
  }
}

async function sample() {
  const signal = begin();
  try {
    const response = await request("viewer/sample.ply", { signal });
    await upload(new File([await response.blob()], "bracket.ply"));
  } catch (error) {
    fail(error, sample);
  }
}

function route() {
  const { id, look } = read(location.hash);
  if (!id) home();
  else if (id !== current?.id) open(id);
  else if (root.dataset.state === "result" && controls?.display) controls.look = look;
}

/** Let the address say what is seen, so that a link shows it; a moment later, for browsers limit how often. */
function remember() {
  clearTimeout(remember.timer);
  remember.timer = setTimeout(() => {
    if (root.dataset.state !== "result" || read(location.hash).id !== current?.id) return;
    const { format } = downloads;
    history.replaceState(null, "", write(current.id, { ...controls?.look, format, against: comparison.against }));
  }, 200);
}

function take(files) {
  if (!files.length) return;
  if (files.length > 1) say(`One file at a time: ${files[0].name} is taken.`);
  if (picked) picked(files[0]);
  else if (options.check()) upload(files[0]);
  picked = null;
}

function toggleTheme() {
  const dark = (root.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  root.dataset.theme = dark ? "light" : "dark";
  try {
    localStorage.setItem("theme", root.dataset.theme);
  } catch {
    // Not remembered, then.
  }
  controls?.stage.draw();
}

function leave() {
  if (location.hash) location.hash = "#/";
  else home();
}

function listen() {
  $("pick").addEventListener("click", () => $("input").click());
  $("input").addEventListener("cancel", () => (picked = null));
  $("problem-pick").addEventListener("click", () => $("input").click());
  $("problem-home").addEventListener("click", leave);
  $("problem-retry").addEventListener("click", () => retry?.());
  $("another").addEventListener("click", leave);
  $("sample").addEventListener("click", sample);
  $("cancel").addEventListener("click", cancel);
  $("again").addEventListener("click", () => again.show(current, downloads.format));
  $("unit").append(...UNITS.map((unit) => new Option(unit || "Unknown", unit)));
  $("unit").value = fileUnit();
  $("unit").addEventListener("change", () => {
    setFileUnit($("unit").value);
    tell();
  });
  $("more").addEventListener("toggle", () => options.models().catch(fail));
  $("theme").addEventListener("click", toggleTheme);
  $("input").addEventListener("change", () => {
    take([...$("input").files]);
    $("input").value = "";
  });
  let depth = 0; // of nested elements under the pointer
  const veil = (change) => {
    depth = change === 0 ? 0 : Math.max(0, depth + change);
    $("veil").classList.toggle("shown", depth > 0);
  };
  window.addEventListener("dragenter", (event) => event.dataTransfer.types.includes("Files") && veil(1));
  window.addEventListener("dragleave", (event) => event.dataTransfer.types.includes("Files") && veil(-1));
  window.addEventListener("dragover", (event) => event.preventDefault());
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    veil(0);
    take([...event.dataTransfer.files]);
  });
  window.addEventListener("hashchange", route);
  window.addEventListener("popstate", route);
  window.addEventListener("offline", () => say("This device has lost its network connection."));
  window.addEventListener("online", () => say("The network connection is back."));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => controls?.stage.draw());
}

function start() {
  const background = () => getComputedStyle($("stage")).getPropertyValue("--stage").trim();
  try {
    const save = async () => keep(await controls.stage.picture(), `${current.upload.name ?? "cloud"}_${controls.stage.view}.png`);
    controls = new Controls(new Stage($("canvas"), background), { announce, save, changed: remember });
  } catch {
    say("This browser cannot draw in three dimensions (WebGL is off). Denoising and downloads work without.");
  }
  onKeyNeeded(askForKey);
  installKeys([...(controls?.keys() ?? []), [["n"], "New file", leave]], [
    [["t"], "Dark or light", toggleTheme],
    [["?"], "This list", () => $("keys-dialog").showModal()],
  ], () => root.dataset.state === "result" && $("stage").dataset.drawing === "true");
  listen();
  route();
}

start();
