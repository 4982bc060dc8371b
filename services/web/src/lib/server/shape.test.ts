import { expect, test } from "vitest";
import { highwayShape, scoreText, shapeOf, valuesText } from "./shape";
import type { ParameterSpacePage, ProblemAnswer, ScenarioPage } from "./types";

const HEATER: ProblemAnswer = {
  name: "heater", digest: "d", size: 1, latest: true, created_at: "2026-01-01T00:00:00Z", links: {}, description: "",
  parameters: {
    gain: { lower: 0, upper: 2, step: null, integer: false, choices: null, unit: "W/K", description: "Power" },
    stage: { lower: 0.5, upper: 2.5, step: 0.5, integer: false, choices: null, unit: "kW", description: "" },
    rooms: { lower: 1, upper: 6, step: null, integer: true, choices: null, unit: "1", description: "" },
    mode: { lower: null, upper: null, step: null, integer: false, choices: ["eco", "boost"], unit: "1", description: "" },
  },
  constraints: ["gain <= stage"], baseline: null, simulator: { kind: "command" }, scenarios: { winter: { outside: -10, gusts: [1, 2] } },
  measures: {}, failures: [], series: {},
  scores: { cost: { formula: "e", direction: "minimise", range: [0, 100], tolerance: 2, failed: null, unit: "EUR" } },
};

test("a pushed problem has parameters of every kind, scenarios and scores", () => {
  const shape = shapeOf(HEATER);
  expect(shape.parameters.map((parameter) => [parameter.kind, valuesText(parameter)])).toEqual([
    ["continuous", "0 to 2"], ["grid", "0.5 to 2.5, step 0.5"], ["integer", "1 to 6, whole numbers"], ["choice", "eco, boost"],
  ]);
  expect(shape.scenarios).toEqual([{ id: "winter", title: "outside -10, gusts [1,2]" }]);
  expect(shape.scores.map(scoreText)).toEqual(["cost / EUR, 0 to 100, less is better"]);
});

test("the built-in problem has the parameters of its driving function and the scenarios of its catalogue", () => {
  const parameter = { name: "P1", unit: "s", lower: 0, upper: 1, step: 0.1, n_values: 11, description: "Horizon", kind: "grid", choices: [] };
  const spaces: ParameterSpacePage = { items: [{ driving_function: "other", name: "highway", parameters: [] }, { driving_function: "frenet", name: "highway", parameters: [parameter] }], next_cursor: null, broken: [] };
  const scenario = { id: "S1", catalogue: "highway", title: "Free road", manoeuvre: "", duration: 1, step: 0.1, vehicles: 0 };
  const scenarios: ScenarioPage = { items: [scenario, { ...scenario, catalogue: "mine", id: "M1" }], next_cursor: null, scores: ["comfort"], measures: { offset_peak_m: "m" }, broken: [] };
  const shape = highwayShape(spaces, scenarios);
  expect(shape.parameters).toMatchObject([{ name: "P1", meaning: "Horizon", step: 0.1 }]);
  expect(shape.scenarios).toEqual([{ id: "S1", title: "Free road" }]);
  expect(shape.goals).toEqual({ scores: ["comfort"], measures: ["offset_peak_m"] });
});
