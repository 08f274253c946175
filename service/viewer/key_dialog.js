// The dialog that asks for the service's key.

const $ = (id) => document.getElementById(id);

/** Ask; `sent` says whether a key was sent and is unknown. Returns a promise of the key, or of null. */
export function askForKey(sent) {
  const dialog = $("key-dialog");
  $("key-text").textContent = sent ? "The service does not know the key that was sent." : "This service asks for a key.";
  $("key").value = "";
  dialog.showModal();
  return new Promise((resolve) => {
    const settle = (value) => (event) => {
      event.preventDefault();
      dialog.close();
      listeners.abort();
      resolve(value());
    };
    const listeners = new AbortController();
    const { signal } = listeners;
    $("key-form").addEventListener("submit", settle(() => $("key").value.trim()), { signal });
    $("key-cancel").addEventListener("click", settle(() => null), { signal });
    dialog.addEventListener("cancel", settle(() => null), { signal });
  });
}
