/** The searches of several campaigns on one chart. */

import { SERIES } from "./palette";
import type { Series } from "./plot";
import type { Campaign, CampaignSetup, Generation } from "../server/types";

const DASHES = [undefined, "7 3", "2 3", "9 3 2 3", "4 2"];

/** What the best objectives of a campaign are: its first objective, else its score, by the formula of its `evaluator`. */
export type Measure = Pick<Campaign["scale"], "name" | "unit" | "direction"> & { evaluator?: string | undefined };
type Scored = Pick<Campaign, "scale"> & { setup?: Pick<CampaignSetup, "evaluator" | "scenarios"> | null };
export type Over = "iteration" | "simulations";

function measureOf({ objective, scale, setup }: Scored & Pick<Campaign, "objective">): Measure {
  const { name, unit, direction } = objective ?? scale;
  return { name, unit, direction, evaluator: objective ? undefined : setup?.evaluator };
}

/** Whether the simulations of campaigns have the same files in each scenario. */
export function haveLikeFiles(campaigns: readonly Scored[]): boolean {
  const rows = Map.groupBy(campaigns.flatMap(({ setup }) => setup?.scenarios ?? []), ({ scenario }) => scenario);
  return [...rows.values()].every((like) => new Set(like.flatMap(({ files }) => files ?? [])).size < 2);
}

/** Whether the scores of campaigns, by scenario, are on one scale, and of one formula and simulation. */
export function haveLikeScores(campaigns: readonly Scored[]): boolean {
  const formulas = new Set(campaigns.flatMap(({ setup }) => setup?.evaluator ?? []));
  return formulas.size < 2 && haveLikeFiles(campaigns) && new Set(campaigns.map(({ scale }) => JSON.stringify(scale))).size < 2;
}

/** Searches by what their objectives are: other names, units or directions, or of scores other formulas or weights, need another axis. */
export function byMeasure<T extends { of: Scored & Pick<Campaign, "objective">; weights?: string }>(searches: readonly T[]): { measure: Measure; searches: T[] }[] {
  const groups = Map.groupBy(searches, ({ of, weights }) => JSON.stringify({ ...measureOf(of), files: [...new Set(of.setup?.scenarios.map(({ files }) => files))], weights: of.objective ? undefined : weights }));
  return [...groups].map(([measure, like]) => ({ measure: JSON.parse(measure) as Measure, searches: like }));
}

/** A search with a budget asks cell by cell: its rounds are no iterations. */
export function overOf(campaigns: readonly Pick<Campaign, "budget">[]): Over {
  return campaigns.some(({ budget }) => budget !== null) ? "simulations" : "iteration";
}

/** The iterations of a search, counted from 1, or the simulations so far: requested cells that neither copies nor predictions answered. */
export function placesOf(generations: readonly Generation[], over: Over): number[] {
  let taken = 0;
  return generations.map(({ iteration, requested, repeated, reused, predicted }) => (over === "iteration" ? iteration + 1 : (taken += requested - repeated - reused - predicted)));
}

/** Best and mean objective over the simulations so far, or the iterations, with what is best now: after a round, and in the midst of one. */
export function courseOf({ best, cells }: Pick<Campaign, "best" | "cells">, generations: readonly Generation[], over: Over = "simulations"): (Pick<Generation, "best" | "mean"> & { at: number })[] {
  const places = placesOf(generations, over);
  const course = generations.map((generation, place) => ({ best: generation.best, mean: generation.mean, at: places[place] ?? 0 })).filter((point) => point.best !== null);
  return best === null ? course : [...course, { best: best.objective, mean: null, at: over === "iteration" ? (places.at(-1) ?? 0) : cells.simulated + cells.failed }];
}

/** Most pixels between lines that would lie on each other, and between the outermost of them. */
const [BETWEEN, SPREAD] = [2, 10];

/** The course of each search as a line. `place`: which colour and dash its group has. */
export function overlay(searches: readonly { name: string; group: string; place: number; values: readonly (number | null)[]; x: readonly number[] }[]): Series[] {
  return searches.map(({ place, ...line }, at) => ({
    ...line,
    colour: SERIES[place % SERIES.length] ?? "",
    dash: DASHES[place % DASHES.length],
    steps: true,
    shift: searches.length > 1 ? Math.min(BETWEEN, SPREAD / searches.length) * (at + 0.5 - searches.length / 2) : 0,
  }));
}
