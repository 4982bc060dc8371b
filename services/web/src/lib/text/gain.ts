/** How much better a value is than another. */

/** How much better the best is than the baseline, in units of the score; negative if it is worse. */
export function gain(best: number | null | undefined, baseline: number | null | undefined, minimised: boolean): number | null {
  if (best === null || best === undefined || baseline === null || baseline === undefined) return null;
  return minimised ? baseline - best : best - baseline;
}

/** What a gain means: nothing as long as it is within the tolerance. */
export type Change = "better" | "worse" | "equal" | "within";

export const SIGNS: Readonly<Record<Change, string>> = { better: "▲", worse: "▼", equal: "=", within: "≈" };

/** Differences by rounding alone are none. */
const ROUNDING = 1e-9;

export function changeOf(gain: number, tolerance: number): Change {
  if (Math.abs(gain) <= ROUNDING) return "equal";
  if (Math.abs(gain) <= tolerance + ROUNDING) return "within";
  return gain > 0 ? "better" : "worse";
}

/** A gain with its sign. */
export function signed(gain: number, text: string): string {
  return `${gain > 0 ? "+" : gain < 0 ? "−" : ""}${text}`;
}
