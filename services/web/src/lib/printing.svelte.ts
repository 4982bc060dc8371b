/** Printing: the page as it stands, scaled to the paper, in light colours, with what is scrolled on the screen. */

import { flushSync } from "svelte";
import { isDark } from "./theme.svelte";

/** Pixels between the margins of A4 or Letter across. */
const PAPER = 975;
let printed = $state(false);

/** Whether the page is being printed. */
export function isPrinted(): boolean {
  return printed;
}

/** Whether cells of a table lie on a dark ground: never on paper. */
export function onDark(): boolean {
  return isDark() && !printed;
}

/** The main part, and what is scrolled sideways in it. */
const boxes = (): HTMLElement[] => [...document.querySelectorAll<HTMLElement>("main, .scroll, .grid, .room")];

function fit(): void {
  flushSync(() => (printed = true));
  for (const box of boxes().reverse()) {
    const isMain = box.tagName === "MAIN";
    const [room, wanted] = [isMain ? PAPER : box.clientWidth, isMain ? box.offsetWidth : box.scrollWidth];
    if (isMain) box.style.width = `${wanted}px`;
    box.style.zoom = String(Math.min(1, room / wanted));
  }
  // Chromium loses lines that are drawn on a canvas now: dark drawings are inverted, not drawn again.
  for (const canvas of document.querySelectorAll("canvas")) canvas.style.filter = isDark() ? "invert(1) hue-rotate(180deg)" : "";
}

function release(): void {
  printed = false;
  for (const box of boxes()) box.style.zoom = box.style.width = "";
  for (const canvas of document.querySelectorAll("canvas")) canvas.style.filter = "";
}

window.addEventListener("beforeprint", fit);
window.addEventListener("afterprint", release);
