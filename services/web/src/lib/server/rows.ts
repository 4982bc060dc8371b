/** The columns of the tables that the page reads. Not asked of the server, whose own description takes it long to make at first. */

import type { EvaluationRow, JudgedSet, Solution } from "./types";

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
    proven_by: "number",
    proof_agrees: "other",
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
    scores: "other",
    reused: "other",
    parameters: "other",
    iteration: "number",
    individual: "number",
  } satisfies Kinds<Solution>,
};

export type RowName = keyof typeof ROWS;

/** The columns of a kind of rows: whether each holds numbers. */
export function columnsOf(row: RowName): ReadonlyMap<string, boolean> {
  return new Map(Object.entries(ROWS[row]).map(([name, kind]) => [name, kind === "number"]));
}
