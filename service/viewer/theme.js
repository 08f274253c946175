// Before the first paint: the theme chosen last time. Without a choice the system's is used, by the style sheet.
try {
  const chosen = localStorage.getItem("theme");
  if (chosen === "dark" || chosen === "light") document.documentElement.dataset.theme = chosen;
} catch {
  // No storage, no memory of it.
}
