import { expect, test } from "vitest";
import { shapeOf, withPlugins } from "$lib/server/shape";
import type { ParameterSpacePage, ProblemAnswer, ScenarioPage } from "$lib/server/types";

test("a problem of drivecal's own planner has the parameters of the chosen space and the scenarios of the chosen catalogue", () => {
  const parameter = { name: "P1", unit: "s", lower: 0, upper: 1, step: 0.1, n_values: 11, description: "Horizon", kind: "grid", choices: [] };
  const spaces: ParameterSpacePage = { items: [{ driving_function: "other", name: "others", parameters: [] }, { driving_function: "frenet", name: "coarse", parameters: [parameter] }], next_cursor: null, broken: [] };
  const scenario = { id: "M1", catalogue: "mine", title: "Free road", manoeuvre: "", duration: 1, step: 0.1, vehicles: 0 };
  const scenarios: ScenarioPage = { items: [scenario], next_cursor: null, scores: ["comfort"], measures: { offset_peak_m: "m" }, broken: [] };
  const simulator = { kind: "highway", controller: { kind: "planner", driving_function: "frenet" } };
  const shape = shapeOf({ parameters: {}, shapes: {}, varied: {}, constraints: [], measures: {}, scores: {}, simulator, scenarios: { S1: { title: "A road", task: {} } } } as unknown as ProblemAnswer);
  expect(shape.scenarios).toEqual([{ id: "S1", title: "A road" }]);
  expect(withPlugins(shape, spaces, scenarios, {})).toEqual(shape);
  const chosen = withPlugins(shape, spaces, scenarios, { parameters: "coarse", catalogue: "mine" });
  expect(chosen.parameters).toMatchObject([{ name: "P1", description: "Horizon", step: 0.1 }]);
  expect(chosen.scenarios).toEqual([{ id: "M1", title: "Free road" }]);
});
