/** From a set to the evaluations that it was ranked by. */

import { get } from "./api.svelte";
import { go } from "../route.svelte";
import { number } from "../text/format";
import { knownOf, seedsText } from "../text/words";
import type { Best, Campaign, CellNumber, EvaluationDetail, FrontRow, FrontSummary, PageSolution } from "./types";

/** One of two sets that a view compares. */
export interface SetSide {
  title: string;
  /** Heads its column. */
  column: string;
  parameters: Values;
  scores: Readonly<Record<string, number | null>>;
  objective?: number | null;
  /** Of several objectives: their values, errors and intervals, constrained amounts, and values as `NAME@SCENARIO`. */
  goals?: Pick<FrontRow, "objectives" | "uncertainty" | "constraints" | "values" | "degree">;
  /** Number of its seeds. */
  replicates?: number;
  /** What the runs of a random simulator tell of it; empty without them. */
  known?: string;
  /** How each scenario was answered. */
  answers?: Readonly<Record<string, string>> | undefined;
  /** Scores of the set that it is compared with, under the seeds of its own. */
  beside?: Readonly<Record<string, number | null>>;
  best_objective?: number | null;
  /** Seeds of the runs that make its scores, if there are several. */
  seeds?: readonly number[];
  /** Its evaluations in a scenario by seed; null if there is none. */
  cell: (scenario: string) => Promise<CellNumber | null>;
}

/** The evaluations of the set at a place of the calibration, by seed. */
export const cellAt = (campaign: string, iteration: number, individual: number, scenario: string): Promise<CellNumber> =>
  get<CellNumber>(`/campaigns/${campaign}/cell?iteration=${iteration}&individual=${individual}&scenario=${encodeURIComponent(scenario)}`);

/** The seeds that all of these sets ran under, in the order of the first. */
export const sharedSeeds = ([first, ...others]: readonly CellNumber[]): number[] =>
  (first?.runs ?? []).map(([seed]) => seed).filter((seed) => others.every(({ runs }) => new Map(runs).has(seed)));

/** Sets of a page of the ranking. */
const MOST = 1000;

type Values = Readonly<Record<string, number | string>>;
/** Whether two sets have the same values. */
export const isSame = (wanted: Values, given: Values): boolean => Object.entries(wanted).every(([name, value]) => given[name] === value);

/** A set as it is ranked; undefined if it is not among the first of the ranking. */
export async function ranked(campaign: string, parameters: Values): Promise<PageSolution["items"][number] | undefined> {
  const { items } = await get<PageSolution>(`/campaigns/${campaign}/solutions?limit=${MOST}`);
  return items.find((item) => isSame(parameters, item.parameters));
}

/** The best set's evaluation in a scenario: others of the same objective and rating may come before it. */
export async function bestCell(campaign: string, best: Best, scenario: string): Promise<CellNumber | null> {
  const row = await ranked(campaign, best.parameters);
  return row ? cellAt(campaign, row.iteration, row.individual, scenario) : null;
}

/** The baseline's evaluation in a scenario, the first of the search; null if another set is there. */
async function baselineCell(campaign: string, parameters: Values, scenario: string): Promise<CellNumber | null> {
  const cell = await cellAt(campaign, 0, 0, scenario);
  const { parameters: given } = await get<Pick<EvaluationDetail, "parameters">>(`/evaluations/${cell.evaluation}`);
  return isSame(parameters, given) ? cell : null;
}

/** The baseline of a campaign, if it has one, as a set that a view compares, with the best set or another one; `front`: with its objectives. */
export function baselineSide({ id, best, baseline }: Pick<Campaign, "id" | "best" | "baseline">, ofBest: boolean, front?: FrontSummary | null): SetSide | null {
  if (!baseline) return null;
  const known = ofBest && typeof baseline.best_objective === "number" ? `${seedsText(baseline.seeds)}; the best set has ${number(baseline.best_objective, 4)} under them, and ${number(best?.objective, 4)} as reported` : "";
  return { ...baseline, ...(known && { known, beside: baseline.best_scores }), ...(front?.baseline && { goals: { uncertainty: {}, degree: null, ...front.baseline } }), title: "Baseline", column: "baseline", cell: (scenario) => baselineCell(id, baseline.parameters, scenario) };
}

/** A set of a front or a ranking as a view compares it. */
export function sideOf(campaign: string, set: FrontRow | PageSolution["items"][number]): SetSide {
  const { rank, iteration, individual, parameters, scores, seeds } = set;
  const answers = "answers" in set ? set.answers : Object.fromEntries(set.reused.map((scenario) => [scenario, "reused"]));
  const amounts = "objectives" in set ? { goals: set } : { objective: set.objective, known: knownOf(set) };
  return { title: `Set ${rank}`, column: `set ${rank}`, parameters, scores, answers, seeds, replicates: set.replicates, ...amounts, cell: (scenario) => cellAt(campaign, iteration, individual, scenario) };
}

/** Opens the evaluation of a set in a scenario, or the ranking if there is none. */
export async function openFound(campaign: string, found: Promise<CellNumber | null>): Promise<void> {
  const cell = await found;
  go(cell === null ? ["campaigns", campaign, "ranking"] : ["evaluations", String(cell.evaluation)]);
}
