/** Colours that people who see colours differently can tell apart (Okabe and Ito, 2008). */

import type { Outcome } from "../text/words";

export const COLOURS: Record<Outcome, string> = {
  repeated: "#56b4e9",
  reused: "#0072b2",
  predicted: "#cc79a7",
  simulated: "#e69f00",
  failed: "#d55e00",
};

export const SERIES: readonly string[] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#a09000"];

/** Viridis, from the worst to the best: even in lightness, and the same in grey. */
const VIRIDIS = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"] as const;

/** The colour of a share from 0 (worst) to 1 (best); in the light, the yellow end is left out, for it cannot be seen there. */
export function shade(share: number, dark: boolean): string {
  const first = dark ? 2 : 0;
  const last = dark ? VIRIDIS.length - 1 : VIRIDIS.length - 2;
  return VIRIDIS[Math.round(first + Math.min(1, Math.max(0, share)) * (last - first))] ?? VIRIDIS[0];
}

/** The shade of a colour for thin lines: the strong blue is too dark on a dark ground. */
export function onGround(colour: string, dark: boolean): string {
  return dark && colour === "#0072b2" ? "#3f9fe0" : colour;
}
