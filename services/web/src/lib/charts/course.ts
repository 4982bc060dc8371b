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
