/** The runs of a comparison as the lines of Figures 7 and 8: every run, not only the best. */

import { SERIES } from "./palette";
import type { Series } from "./plot";
import type { ComparedRun, Generation } from "../server/types";

/** What is drawn of a generation: the best objective, or the rating of the best set, which tells optima of equal objective apart. */
export type Shown = "best" | "rating";

const DASHES = [undefined, "6 3", "2 2", "8 2 2 2"];
/** Pixels between the outermost of lines that would lie on each other. */
const SPREAD = 10;

/** How the runs of one optimizer differ besides their seed: by population, and by reduction if there are several. */
export function kindOf(run: ComparedRun, several: boolean): string {
  return several ? `${run.population} individuals, ${run.reduction}` : `${run.population} individuals`;
}

export function kinds(runs: readonly ComparedRun[]): { several: boolean; populations: number[]; reductions: string[] } {
  const reductions = [...new Set(runs.map((run) => run.reduction))];
  return { several: reductions.length > 1, populations: [...new Set(runs.map((run) => run.population))], reductions };
}

/** Requested cells of a generation that neither copies nor predictions answered. */
export function simulationsOf(generation: Generation): number {
  return generation.requested - generation.repeated - generation.reused - generation.predicted;
}

/** Over the iterations, or over the simulations that the run would have taken alone. Each kind has its colour, where there are enough; dashes
 * are of reductions. */
export function lines(
  all: readonly ComparedRun[],
  optimizer: string,
  generations: Readonly<Record<string, readonly Generation[]>>,
  shown: Shown,
  over: "iteration" | "simulations",
): Series[] {
  const { several, populations, reductions } = kinds(all);
  const mine = all.filter((entry) => entry.optimizer === optimizer && (generations[entry.run]?.length ?? 0) > 0);
  return mine.map((run, place) => {
    const rows = generations[run.run] ?? [];
    let taken = 0;
    const simulations = rows.map((entry) => (taken += simulationsOf(entry)));
    const population = populations.indexOf(run.population);
    const kind = populations.length * reductions.length > SERIES.length ? population : population * reductions.length + reductions.indexOf(run.reduction);
    const dash = DASHES[reductions.indexOf(run.reduction) % DASHES.length];
    return {
      name: run.run,
      group: kindOf(run, several),
      values: rows.map((entry) => entry[shown]),
      x: over === "iteration" ? rows.map((entry) => entry.iteration + 1) : simulations,
      colour: SERIES[kind % SERIES.length] ?? "",
      steps: true,
      shift: mine.length > 1 ? SPREAD * ((place + 0.5) / mine.length - 0.5) : 0,
      ...(dash === undefined ? {} : { dash }),
    };
  });
}

/** From the smallest to the largest, with a little room; one scale for all charts of a kind. */
export function span(values: readonly (number | null)[]): [number, number] {
  const known = values.filter((entry): entry is number => entry !== null);
  if (known.length === 0) return [0, 1];
  // all runs' iterations may be more values than a call takes arguments
  const low = known.reduce((entry, other) => Math.min(entry, other));
  const high = known.reduce((entry, other) => Math.max(entry, other));
  const margin = 0.08 * (high - low) || 0.5;
  return [low - margin, high + margin];
}
