/** The searches of several campaigns on one chart. */

import { simulationsOf } from "./comparison";
import { SERIES } from "./palette";
import type { Series } from "./plot";
import type { Generation } from "../server/types";

const DASHES = [undefined, "7 3", "2 3", "9 3 2 3", "4 2"];

/** The best objective of each search over its iterations, counted from 1, or over the simulations so far. */
export function overlay(searches: readonly { name: string; generations: readonly Generation[] }[], over: "iteration" | "simulations"): Series[] {
  return searches.map(({ name, generations }, place) => {
    let taken = 0;
    const simulations = generations.map((generation) => (taken += simulationsOf(generation)));
    const dash = DASHES[place % DASHES.length];
    return {
      name,
      values: generations.map((generation) => generation.best),
      x: over === "iteration" ? generations.map((generation) => generation.iteration + 1) : simulations,
      colour: SERIES[place % SERIES.length] ?? "",
      steps: true,
      group: name,
      ...(dash === undefined ? {} : { dash }),
    };
  });
}
