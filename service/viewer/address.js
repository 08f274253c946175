// The address of the page: which job is shown, and how. `#/jobs/ID?view=side&colour=height`

/** Return { id, look } of an address; the id is undefined at the start page. */
export function read(hash) {
  const [, id, query = ""] = hash.match(/^#\/jobs\/([\w-]+)(?:\?(.*))?$/) ?? [];
  return { id, look: Object.fromEntries(new URLSearchParams(query)) };
}

/** Return the address of a job; parts of its look that are empty are left out. */
export function write(id, look = {}) {
  const parts = Object.entries(look).filter(([, value]) => value !== "").map(([name, value]) => `${name}=${value}`);
  return `#/jobs/${id}${parts.length ? "?" : ""}${parts.join("&")}`;
}
