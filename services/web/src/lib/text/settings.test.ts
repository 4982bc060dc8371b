import { expect, test } from "vitest";
import { asked } from "./settings";

test("what was asked for is told with all settings that were chosen, and nothing that is empty", () => {
  const spec = {
    catalogue: ["S3", "S5"], weights: { S3: 2 }, driving_function: "frenet", vehicle: { model: "hybrid", parameters: {} }, evaluator: "learned", fixed: {}, baseline: null,
    optimizer: { kind: "genetic", population: 200, iterations: 15, start: "lhs", seed: 1, start_sets: [], mutation: 0.2 },
    reduction: { mode: "influence", audit: 0.02, max_error: 0.02, narrow: false, confirm: 20, certified: true }, sensitivity: { map: "0123456789abcdef" }, robustness: null,
  };
  expect(asked({ kind: "calibration", spec }, null)).toEqual([
    ["Scenarios", "S3, S5"],
    ["Weights", "S3 2"],
    ["Driving function", "frenet"],
    ["Vehicle", "hybrid"],
    ["Evaluator", "learned"],
    ["Optimizer", "genetic: population 200, iterations 15, start lhs, seed 1, mutation 0.2"],
    ["Sensitivity", "the stored influence map 01234567"],
    ["Reduction", "influence: 2.0 % audited, at most 2.0 % of the answers in lots expected to be released and wrong, best set confirmed by simulation, at most 20 sets"],
  ]);
});

test("predictions are told with their tolerance and limit, where a campaign predicts", () => {
  const settings = { audit: 0.02, max_error: 0.02, confirm: 0, tolerance: 1, limit: 0.01 };
  const said = (mode: string): string => asked({ kind: "calibration", spec: { optimizer: { kind: "genetic" }, reduction: { mode, ...settings } } }, null).at(-1)?.[1] ?? "";
  expect(said("predicted")).toMatch(/within 1,.*1\.0 %/);
  expect(said("both")).toMatch(/2\.0 % audited.*within 1,.*1\.0 %/);
  expect(said("exact")).not.toContain("predict");
});

test("what departs from the usual reduction is told", () => {
  const reduction = { mode: "exact", audit: 0.02, max_error: 0.02, narrow: true, certified: false };
  expect(asked({ kind: "calibration", spec: { optimizer: { kind: "genetic" }, reduction } }, null).at(-1)).toEqual(["Reduction", "exact: influenced ranges alone searched"]);
});
