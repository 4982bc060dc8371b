import { expect, test } from "vitest";
import { CsvReader } from "$lib/server/columns";
import { binned, conditions, numbered, select } from "$lib/server/select";
import type { Scale } from "$lib/server/types";
import { chosen, colouring, marks, parameterAxes, positions, scoreAxis } from "$lib/charts/axes";

const COST: Scale = { name: "cost", direction: "minimise", lower: 0, upper: 100, tolerance: 2, failed: 120, step: null, unit: "EUR" };
const PARAMETERS = [
  { name: "T", column: "T", unit: "s", lower: 0.8, upper: 2.5, kind: "continuous" },
  { name: "mode", column: "mode", unit: "1", lower: 0, upper: 2, kind: "choice", choices: ["eco", "normal", "sport"] },
  { name: "stage", column: "parameter_stage", unit: "m", lower: 1, upper: 6, kind: "integer" },
];

function table() {
  const reader = new CsvReader(new Set(["stage"]));
  reader.push("stage,T,mode,parameter_stage,score\ncalibration,0.9,sport,2,120\ncalibration,1.5,eco,3,40\nsensitivity,2,old,4,10\ncalibration,2.4,eco,5,70\n");
  return reader.finish();
}

test("every kind of parameter has an axis, choices in their own order and unknown ones behind them", () => {
  const [time, mode, stage] = parameterAxes(table(), PARAMETERS);
  expect(time).toEqual({ name: "T", title: "T / s", parameter: "T", lower: 0.8, upper: 2.5 });
  expect(mode).toEqual({ name: "mode", title: "mode", parameter: "mode", lower: 0, upper: 3, choices: ["eco", "normal", "sport", "old"] });
  expect(stage).toEqual({ name: "parameter_stage", title: "stage / m", parameter: "stage", lower: 1, upper: 6 });
  expect([...positions(table(), mode ?? { name: "" })]).toEqual([2, 0, 3, 0]);
  expect(parameterAxes(table(), [])).toEqual([]);
});

test("a range of a choice keeps its texts", () => {
  const [, mode] = parameterAxes(table(), PARAMETERS);
  expect([...select(table(), { words: {}, ranges: { mode: [0, 1.4] }, axes: mode ? [mode] : [] })]).toEqual([1, 3]);
  expect(mode && chosen(mode, [0.5, Infinity])).toEqual(["normal", "sport", "old"]);
});

test("a selection is written as conditions of the API", () => {
  const axes = parameterAxes(table(), PARAMETERS);
  expect(conditions({ words: { stage: ["calibration", "validation"] }, ranges: { T: [1, Infinity], mode: [0, 1], score: [-Infinity, 50] }, axes })).toEqual([
    "stage=calibration", "stage=validation", "mode=eco", "mode=normal", "T>=1", "score<=50",
  ]);
  expect(conditions({ words: { stage: [] }, ranges: { mode: [0.2, 0.4] }, axes })).toEqual(["mode="]);
});

test("a choice that is kept by words and by a range has the rows of both in a file as well", () => {
  const axes = parameterAxes(table(), PARAMETERS);
  const both = (mode: string[], range: [number, number]) => conditions({ words: { mode }, ranges: { mode: range }, axes });
  expect(both(["eco", "sport"], [0, 1])).toEqual(["mode=eco"]);
  expect(both(["sport"], [0, 1])).toEqual(["mode="]);
});

test("the axis of a score spans its values, and less is brighter where less is better", () => {
  expect(scoreAxis(table(), "score", COST)).toEqual({ name: "score", title: "score / EUR", lower: 10, upper: 120 });
  expect(colouring("score", COST)).toEqual({ name: "score", worst: 100, best: 0 });
  expect(colouring("score", { ...COST, direction: "maximise" }, [3, 5])).toEqual({ name: "score", worst: 3, best: 5 });
  const bins = binned(numbered(4), Float64Array.of(120, 40, 10, 70), 100, 0, 4);
  expect(bins.map((bin) => [...bin])).toEqual([[], [0], [3], [1], [2]]);
});

test("choices are written beside their axis, of many some", () => {
  expect(marks(["eco", "a very long name of it"])).toEqual([[0, "eco"], [1, "a very long…"]]);
  expect(marks(Array.from({ length: 40 }, (_, place) => String(place))).length).toBe(10);
});
