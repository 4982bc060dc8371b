/** The compared campaigns as the lines of Figures 7 and 8: every run, not only the best. */

import { SERIES } from "./palette";
import type { Series } from "./plot";
import type { ComparedRun } from "../server/types";

/** What is drawn: the best objective, or the rating of the best set, which separates optima of equal objective. */
export type Shown = "best" | "rating";

const DASHES = [undefined, "6 3", "2 2", "8 2 2 2"];
/** Pixels between the outermost of lines that would lie on each other. */
const SPREAD = 10;

export function several(runs: readonly ComparedRun[]): boolean {
  return new Set(runs.map((run) => run.reduction)).size > 1;
}

/** How the runs of one optimizer differ besides their seed: by population, and by reduction if there are several. */
export function kindOf(run: ComparedRun, reduced: boolean): string {
  return reduced ? `${run.population} individuals, ${run.reduction}` : `${run.population} individuals`;
}

/** The runs of an optimizer over iterations or simulations. Each kind has its colour, if there are enough; dashes are of reductions. */
export function lines(runs: readonly ComparedRun[], optimizer: string, shown: Shown, over: "iteration" | "simulations"): Series[] {
  const populations = [...new Set(runs.map((run) => run.population))];
  const reductions = [...new Set(runs.map((run) => run.reduction))];
  const mine = runs.filter((run) => run.optimizer === optimizer && run.course.length > 0);
  return mine.map((run, place) => {
    const [population, reduction] = [populations.indexOf(run.population), reductions.indexOf(run.reduction)];
    const kind = populations.length * reductions.length > SERIES.length ? population : population * reductions.length + reduction;
    const dash = DASHES[reduction % DASHES.length];
    return {
      name: run.campaign,
      group: kindOf(run, reductions.length > 1),
      values: run.course.map((step) => step[shown]),
      x: run.course.map((step) => step[over]),
      colour: SERIES[kind % SERIES.length] ?? "",
      steps: true,
      shift: mine.length > 1 ? SPREAD * ((place + 0.5) / mine.length - 0.5) : 0,
      ...(dash === undefined ? {} : { dash }),
    };
  });
}
