/** Whether colours are for a dark ground: canvases have to know, for no style sheet reaches into them. */

const system = window.matchMedia("(prefers-color-scheme: dark)");

function now(): boolean {
  const chosen = document.documentElement.dataset["theme"];
  return chosen === undefined ? system.matches : chosen === "dark";
}

let dark = $state(now());
system.addEventListener("change", () => (dark = now()));
window.addEventListener("themechange", () => (dark = now()));

export function isDark(): boolean {
  return dark;
}
