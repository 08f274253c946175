// The keyboard: single keys while a result is shown, and the list of them.

const $ = (id) => document.getElementById(id);
const NAMES = { " ": "Space", ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };
const TEXT = "input:not([type=radio]):not([type=range]), select, textarea";

/** Listen; `entries` are [keys, label, action(key, shift)], the ones of `always` work in every state. */
export function installKeys(entries, always, active) {
  const actions = (list) => new Map(list.flatMap(([keys, , action]) => keys.map((key) => [key, action])));
  const [shown, everywhere] = [actions(entries), actions(always)];
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (event.target.closest(`${TEXT}, dialog`)) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const own = event.target.closest("button, a") ? [" "] : event.target.closest("input") ? [" ", "Arrow"] : [];
    if (own.some((used) => key.startsWith(used))) return; // the control's own keys
    const action = everywhere.get(key) ?? (active() ? shown.get(key) : undefined);
    if (!action) return;
    event.preventDefault();
    action(key, event.shiftKey);
  });
  $("keys-list").replaceChildren(...[...entries, ...always].map(([keys, label]) => {
    const row = document.createElement("div");
    const term = document.createElement("dt");
    for (const key of keys.filter((key) => key !== "=")) {
      const cap = document.createElement("kbd");
      cap.textContent = NAMES[key] ?? key.toUpperCase();
      term.append(cap);
    }
    const detail = document.createElement("dd");
    detail.textContent = label;
    row.append(term, detail);
    return row;
  }));
  $("help").addEventListener("click", () => $("keys-dialog").showModal());
  $("keys-close").addEventListener("click", () => $("keys-dialog").close());
}
