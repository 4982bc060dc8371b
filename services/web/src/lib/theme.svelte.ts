/** Which colours the page has. Canvases and charts ask for it: no style sheet reaches into them. */

import { onGround } from "./charts/palette";

export const THEMES = ["system", "light", "dark"] as const;
export type Theme = (typeof THEMES)[number];

const system = window.matchMedia("(prefers-color-scheme: dark)");
let systemDark = $state(system.matches);
system.addEventListener("change", () => (systemDark = system.matches));

const stored = THEMES.find((theme) => theme === localStorage.getItem("theme")) ?? "system";
export const chosen = $state<{ theme: Theme }>({ theme: stored });

export function isDark(): boolean {
  return chosen.theme === "system" ? systemDark : chosen.theme === "dark";
}

/** A colour of the palette as it is best seen on the page. */
export function tone(colour: string): string {
  return onGround(colour, isDark());
}
