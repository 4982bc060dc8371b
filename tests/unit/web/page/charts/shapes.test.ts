import { expect, test } from "vitest";
import type { ShapeAnswer } from "$lib/server/types";
import { chartOf, overlaid, rowsOf } from "$lib/charts/shapes";

const CURVE: ShapeAnswer = { names: ["g_1", "g_2"], axes: [[0, 5, 10]], axis_units: ["m/s"], weights: [[[1, 0], [0.5, 0.5], [0, 1]]], lower: 0, upper: 2, step: 0.1, unit: "1/s", description: "", good: null };
const MAP: ShapeAnswer = { ...CURVE, names: ["m_1_1", "m_1_2"], axes: [[0, 1], [0, 5, 10]], axis_units: ["1", "m/s"], weights: [[[1], [1]], [[1, 0], [0.5, 0.5], [0, 1]]] };

test("values are weighed, rounded to the step and held in the range", () => {
  expect(rowsOf(CURVE, { g_1: 1, g_2: 1.5 })).toEqual([[1, 1.2, 1.5]]);
  expect(rowsOf({ ...CURVE, step: null }, { g_1: 1, g_2: 9 })).toEqual([[1, 2, 2]]);
  expect(rowsOf(MAP, { m_1_1: 0, m_1_2: 1 })).toEqual([[0, 0.5, 1], [0, 0.5, 1]]);
});

test("a chart has a line for each row, the other set and the range of good sets", () => {
  const good = { sets: 3, within: 0.1, lower: [0, 0, 0], upper: [2, 2, 2] };
  const curve = chartOf("g", { ...CURVE, good }, { g_1: 1, g_2: 1.5 }, { g_1: 0, g_2: 0 }, "baseline");
  expect(curve.series.map(({ name }) => name)).toEqual(["this set", "baseline", "lowest of 3 good sets", "highest of 3 good sets"]);
  expect([curve.xTitle, curve.yTitle, curve.x]).toEqual(["axis, m/s", "g, 1/s", [0, 5, 10]]);
  const ranges = { ...good, lower: [[0, 0, 0], [0, 0, 1]], upper: [[2, 2, 2], [2, 2, 2]] };
  expect(chartOf("m", { ...MAP, good: ranges }, { m_1_1: 0, m_1_2: 1 }, null, "baseline").series.map(({ values }) => values[2])).toEqual([1, 1, 0, 1, 2, 2]);
  const sets = [CURVE, undefined, { ...CURVE, good }, { ...CURVE, axes: [[0, 5, 11]] }].map((shape, place) => ({ title: `c${place}`, shape, parameters: { g_1: 1, g_2: place } }));
  expect(overlaid("g", sets)?.series.map(({ name }) => name)).toEqual(["c0", "c2", "c2, lowest of 3 good sets", "c2, highest of 3 good sets"]);
});
