import { expect, test } from "vitest";
import { scoreText, shapeOf, valuesText, withPlugins } from "./shape";
import type { ParameterSpacePage, ProblemAnswer, ScenarioPage } from "./types";

const HEATER: ProblemAnswer = {
  name: "heater", digest: "d", size: 1, latest: true, created_at: "2026-01-01T00:00:00Z", links: {}, description: "", varied: {},
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

test("a problem of drivecal's own planner has the parameters of the chosen space and the scenarios of the chosen catalogue", () => {
  const parameter = { name: "P1", unit: "s", lower: 0, upper: 1, step: 0.1, n_values: 11, description: "Horizon", kind: "grid", choices: [] };
  const spaces: ParameterSpacePage = { items: [{ driving_function: "other", name: "others", parameters: [] }, { driving_function: "frenet", name: "coarse", parameters: [parameter] }], next_cursor: null, broken: [] };
  const scenario = { id: "M1", catalogue: "mine", title: "Free road", manoeuvre: "", duration: 1, step: 0.1, vehicles: 0 };
  const scenarios: ScenarioPage = { items: [scenario], next_cursor: null, scores: ["comfort"], measures: { offset_peak_m: "m" }, broken: [] };
  const simulator = { kind: "highway", controller: { kind: "planner", driving_function: "frenet" } };
  const shape = shapeOf({ ...HEATER, simulator, scenarios: { S1: { title: "A road", task: {} } } });
  expect(shape.scenarios).toEqual([{ id: "S1", title: "A road" }]);
  expect(withPlugins(shape, spaces, scenarios, {})).toEqual(shape);
  const chosen = withPlugins(shape, spaces, scenarios, { parameters: "coarse", catalogue: "mine" });
  expect(chosen.parameters).toMatchObject([{ name: "P1", meaning: "Horizon", step: 0.1 }]);
  expect(chosen.scenarios).toEqual([{ id: "M1", title: "Free road" }]);
});
