/** The course of a search: its best objective after each iteration, beside what it is compared with. */

import type { Generation } from "../server/types";
import { SERIES } from "./palette";
import type { Series } from "./plot";

export interface Course {
  x: number[];
  series: Series[];
}

/** Lines over the finished iterations, counted from 1; `baseline`: the objective of the set to compare with, null without one. */
export function courseOf(generations: readonly Pick<Generation, "iteration" | "best" | "mean">[], baseline: number | null): Course {
  const known = generations.filter((generation) => generation.best !== null);
  const x = known.map((generation) => generation.iteration + 1);
  const series: Series[] = [
    { name: "best so far", values: known.map((generation) => generation.best), colour: SERIES[0] ?? "", steps: true },
    { name: "mean of the iteration", values: known.map((generation) => generation.mean), colour: SERIES[4] ?? "", dash: "7 3" },
  ];
  if (baseline !== null) series.push({ name: "baseline", values: known.map(() => baseline), colour: SERIES[1] ?? "", dash: "2 3" });
  return { x, series };
}

/** How much better the best is than the baseline, in units of the score; negative if it is worse. */
export function gain(best: number | null | undefined, baseline: number | null | undefined, minimised: boolean): number | null {
  if (best === null || best === undefined || baseline === null || baseline === undefined) return null;
  return minimised ? baseline - best : best - baseline;
}

/** What a gain means: nothing as long as it is within the tolerance. */
export type Change = "better" | "worse" | "equal" | "within";

export const CHANGE: Readonly<Record<Change, { sign: string; words: string }>> = {
  better: { sign: "▲", words: "better" },
  worse: { sign: "▼", words: "worse" },
  equal: { sign: "=", words: "equal" },
  within: { sign: "≈", words: "within the tolerance" },
};

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
