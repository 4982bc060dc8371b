import { expect, test } from "vitest";
import { cell } from "$lib/server/columns";
import type { FrontRow } from "$lib/server/types";
import { kindOf, madeOfText, pairOf, rangeOf, tableOf, withColumns } from "$lib/front/sets";

const row = (rank: number, more: Partial<FrontRow> = {}): FrontRow => ({
  rank, objectives: { f1: rank, f2: -rank }, uncertainty: {}, weighted: null, violation: 0, undecided: false, constraints: { y: 2 }, values: { "f2@plain": -rank }, knee: rank === 2, best_in: rank === 1 ? ["f1"] : [], wins: 0.2, weights: null,
  alternatives: 1, replicates: 1, failures: 0, seeds: [], degree: null, scores: { plain: rank }, reused: [], answers: { plain: "simulated" }, parameters: { x: 0.5, rank: 3, mode: "eco" }, iteration: 0, individual: rank, ...more,
});
const PARAMETERS = ["x", "parameter_rank", "mode"].map((column) => ({ name: column.replace("parameter_", ""), column }));
const ROWS = [row(1), row(2), row(3)];

test("a front is a table with the columns of its files", () => {
  const sets = tableOf([row(1), row(2, { parameters: { x: 1, rank: 4, mode: "boost" }, iteration: 3 })], PARAMETERS, { made: ["of", null] });
  const table = withColumns(sets, { marks: ["best", null] });
  expect(table.names).toEqual(["rank", "objective_f1", "objective_f2", "violation", "undecided", "constraint_y", "value_f2@plain", "knee", "best_in", "wins", "alternatives", "replicates", "failures", "seeds", "degree", "score_plain", "reused", "answer_plain", "iteration", "individual", "x", "parameter_rank", "mode", "made", "marks"]);
  expect(["mode", "parameter_rank", "iteration", "marks", "knee", "degree"].map((name) => cell(table, name, 1))).toEqual(["boost", 4, 3, null, "true", null]);
  expect(tableOf([], PARAMETERS).length).toBe(0);
});

test("a set is as certain as its least certain answer", () => {
  expect(kindOf({ a: "simulated", b: "repeated", c: "reused" })).toBe("reused");
  expect(kindOf({ a: "simulated", b: "confirmed" })).toBe("confirmed");
  expect(madeOfText({ a: "simulated", b: "reused", c: "simulated" })).toBe("1 copied, 2 simulated");
  expect(kindOf(undefined)).toBe("simulated");
});

test("a set is never compared with itself", () => {
  expect(pairOf(ROWS, "2", undefined, null)).toEqual({ current: 1, other: 0 });
  expect(pairOf(ROWS, undefined, "1", null)).toEqual({ current: 2, other: 0 });
  expect(pairOf(ROWS, undefined, "3", 2)).toEqual({ current: 0, other: 2 });
  expect(pairOf(ROWS, "3", "baseline", 2)).toEqual({ current: 2, other: null });
  expect(pairOf(ROWS.slice(0, 1), undefined, undefined, null)).toEqual({ current: 0, other: null });
  expect(pairOf([], "1", "2", null)).toEqual({ current: null, other: null });
});

test("far dominated sets do not press the front into a corner, unless all are asked for", () => {
  expect(rangeOf([0, 10], 12, [11, 500, NaN], false)).toEqual([0, 12 + 0.4 * 12]);
  expect(rangeOf([0, 10], undefined, [11, 500], true)).toEqual([0, 500]);
  expect(rangeOf([5], undefined, [], false)).toEqual([5, 5]);
  expect(rangeOf([5, 5], undefined, [2, 40], false)).toEqual([2, 40]);
});
