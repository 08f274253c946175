// The service as the page uses it. Errors are problems (RFC 9457), shown in the service's own words.

const KEY = "pcdnf-key";

export class Problem extends Error {
  constructor({ title, detail, hint = "", code = "", status = 0 }) {
    super(detail);
    Object.assign(this, { title, detail, hint, code, status });
  }
}

const LOST = {
  title: "The service cannot be reached",
  detail: "The connection to the service was lost.",
  hint: "See that it runs and that the file is not larger than it takes, then try again.",
  code: "connection_lost",
};

let askForKey = async () => null;

/** Set what asks the person for a key: a function of (was one sent) to a promise of the key, or null. */
export function onKeyNeeded(ask) {
  askForKey = ask;
}

export function key() {
  return sessionStorage.getItem(KEY);
}

function authorization() {
  return key() ? { Authorization: `Bearer ${key()}` } : {};
}

function problemOf(status, text) {
  try {
    return new Problem(JSON.parse(text));
  } catch {
    return new Problem({ title: "Unexpected answer", detail: `The service answered ${status}.`, status });
  }
}

/** Send a request; asks for a key where one is needed, and throws a Problem for every answer but a good one. */
export async function request(path, options = {}) {
  for (;;) {
    const headers = { ...options.headers, ...authorization() };
    let response;
    try {
      response = await fetch(path, { ...options, headers });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new Problem(LOST);
    }
    if (response.ok || response.status === 304) return response;
    const problem = problemOf(response.status, await response.text());
    if (response.status !== 401) throw problem;
    const given = await askForKey(key() !== null);
    if (!given) throw problem;
    sessionStorage.setItem(KEY, given);
  }
}

/** Upload a file with parameters and return its job; `progress` is told the share sent, 0 to 1. */
export async function submit(file, { parameters, progress, signal }) {
  await request("jobs?limit=1", { signal }); // a missing key is noticed before a long upload
  const form = new FormData();
  form.append("file", file, file.name);
  return new Promise((resolve, reject) => {
    const upload = new XMLHttpRequest();
    upload.open("POST", `denoise?${new URLSearchParams(parameters)}`);
    for (const [name, value] of Object.entries(authorization())) upload.setRequestHeader(name, value);
    upload.upload.addEventListener("progress", (event) => {
      if (event.lengthComputable) progress(event.loaded / event.total);
    });
    upload.addEventListener("load", () => {
      if (upload.status >= 200 && upload.status < 300) resolve(JSON.parse(upload.responseText));
      else reject(problemOf(upload.status, upload.responseText));
    });
    upload.addEventListener("error", () => reject(new Problem(LOST)));
    upload.addEventListener("abort", () => reject(new DOMException("Cancelled", "AbortError")));
    signal.addEventListener("abort", () => upload.abort());
    if (signal.aborted) upload.abort();
    else upload.send(form);
  });
}

/** Return the body of a response, telling `progress` the share received. */
export async function bytes(response, progress) {
  const total = Number(response.headers.get("Content-Length"));
  const reader = response.body.getReader();
  const parts = [];
  let received = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    received += value.length;
    if (total) progress(received / total);
  }
  return new Blob(parts).arrayBuffer();
}

const wait = (milliseconds, signal) =>
  new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(new DOMException("Left", "AbortError"));
    });
  });

const POLL_MS = 500;
const LONGEST_POLL_MS = 3000;
const PATIENCE_MS = 60000; // of a service that is being restarted
const ANSWER_MS = 10000; // after which a request for a job counts as lost

/** Return the answer to a request for a job; one that does not come in time counts as a lost connection. */
async function ask(id, etag, signal) {
  const late = AbortSignal.timeout(ANSWER_MS);
  try {
    return await request(`jobs/${id}`, {
      signal: AbortSignal.any([signal, late]),
      cache: "no-store",
      headers: etag ? { "If-None-Match": etag } : {},
    });
  } catch (error) {
    throw late.aborted && !signal.aborted ? new Problem(LOST) : error;
  }
}

/**
 * Ask for a job until it has ended, and return it. `seen` is told every state; `lost` is told a problem as soon as the
 * service does not answer, and null once it does again.
 */
export async function follow(id, { seen, lost, signal }) {
  let etag = "";
  let pause = POLL_MS;
  let reached = Date.now();
  for (;;) {
    try {
      const response = await ask(id, etag, signal);
      reached = Date.now();
      lost(null);
      if (response.status === 200) {
        const job = await response.json();
        etag = response.headers.get("ETag") ?? "";
        seen(job);
        if (job.finished_at) return job;
        pause = POLL_MS;
      }
    } catch (error) {
      const passing = error.code === "connection_lost" || error.status >= 503;
      if (!passing || Date.now() - reached > PATIENCE_MS) throw error;
      lost(error);
      pause = POLL_MS;
    }
    await wait(pause, signal);
    pause = Math.min(LONGEST_POLL_MS, pause * 1.2);
  }
}
