/** The columns of the tables that the page reads. Not asked of the server, whose own description takes it long to make at first. */

import type { EvaluationRow, FrontRow, JudgedSet, OptimumRow, RobustnessRow, Solution } from "./types";

/** What the API's types say of a row: the type check refuses columns that differ. */
type Kinds<Row> = {
  [Column in keyof Row as string extends Column ? never : number extends Column ? never : Column]-?: NonNullable<Row[Column]> extends number ? "number" : "other";
};

const ROWS = {
  EvaluationRow: {
    id: "number",
    stage: "other",
    iteration: "number",
    individual: "number",
    scenario: "other",
    outcome: "other",
    score: "number",
    rating: "number",
    reference: "number",
    audited: "other",
    agrees: "other",
    failure: "other",
    milliseconds: "number",
    worker: "other",
    lot: "number",
    confidence: "number",
    sampled: "other",
  } satisfies Kinds<EvaluationRow>,
  JudgedSet: {
    objectives: "other",
    violation: "number",
    on_front: "other",
    iteration: "number",
    individual: "number",
  } satisfies Kinds<JudgedSet>,
  Solution: {
    rank: "number",
    objective: "number",
    rating: "number",
    violation: "number",
    constraints: "other",
    scores: "other",
    reused: "other",
    parameters: "other",
    iteration: "number",
    individual: "number",
  } satisfies Kinds<Solution>,
};

/** Further rows that stand beside parameters in tables and files. */
const BESIDE = {
  OptimumRow: { ...ROWS.Solution, region: "number", to_worse: "number" } satisfies Kinds<OptimumRow>,
  FrontRow: {
    rank: "number",
    objectives: "other",
    weighted: "number",
    violation: "number",
    constraints: "other",
    knee: "other",
    best_in: "other",
    wins: "number",
    weights: "other",
    alternatives: "number",
    degree: "number",
    scores: "other",
    values: "other",
    reused: "other",
    answers: "other",
    parameters: "other",
    iteration: "number",
    individual: "number",
  } satisfies Kinds<FrontRow>,
  RobustnessRow: {
    rank: "number",
    objective: "number",
    rating: "number",
    degree: "number",
    at_least: "other",
    radius: "number",
    recommended: "other",
    reason: "other",
    region: "number",
    to_worse: "number",
    scores: "other",
    parameters: "other",
    trials: "other",
  } satisfies Kinds<RobustnessRow>,
};

const OTHERS = new Set([ROWS.EvaluationRow, ...Object.values(BESIDE)].flatMap(Object.keys));
const PREFIXES = ["score_", "objective_", "constraint_", "value_", "answer_", "measure_"];

/** The column of a parameter, as the API's files name it: no other column of any table has that name. */
export function parameterColumn(name: string): string {
  return OTHERS.has(name) || PREFIXES.some((prefix) => name.startsWith(prefix)) ? `parameter_${name}` : name;
}

/** Path of all evaluations of a campaign. */
export const evaluationsOf = (id: string): string => `/campaigns/${id}/evaluations?format=csv`;

export type RowName = keyof typeof ROWS;

/** The columns of a kind of rows: whether each holds numbers. */
export function columnsOf(row: RowName): ReadonlyMap<string, boolean> {
  return new Map(Object.entries(ROWS[row]).map(([name, kind]) => [name, kind === "number"]));
}
