import { expect, test } from "vitest";
import type { Shape, ShapeParameter } from "$lib/server/shape";
import { checkOf, cloneOf, parameterRows, pastedSet, scenarioRows, withBaselineOf, withProblem, withRange, withScenario, withWeight, type Wanted } from "$lib/forms/space";

const parameter = (name: string, changes: Partial<ShapeParameter>): ShapeParameter => ({ name, kind: "continuous", unit: "1", description: "", lower: 0, upper: 2, step: null, choices: [], ...changes });
const SHAPE = {
  parameters: [
    parameter("gain", { unit: "W/K" }), parameter("stage", { kind: "grid", lower: 0.5, upper: 2.5, step: 0.5 }),
    parameter("rooms", { kind: "integer", lower: 1, upper: 6 }), parameter("mode", { kind: "choice", lower: 0, upper: 2, choices: ["eco", "normal", "boost"] }),
  ],
  curves: {},
  baseline: { gain: 0.5, stage: 1, rooms: 3, mode: "normal" },
  scenarios: [{ id: "winter", title: "" }, { id: "spring", title: "" }],
} as Partial<Shape> as Shape;

test("a range is written only where it differs, and then with all parameters as they are", () => {
  const narrow = withRange(SHAPE, {}, "gain", { upper: 1 });
  expect(narrow["parameters"]).toEqual([
    { name: "gain", lower: 0, upper: 1, unit: "W/K" }, { name: "stage", lower: 0.5, upper: 2.5, step: 0.5, unit: "1" },
    { name: "rooms", lower: 1, upper: 6, integer: true, unit: "1" }, { name: "mode", choices: ["eco", "normal", "boost"], unit: "1" },
  ]);
  expect(parameterRows(SHAPE, narrow)[0]).toMatchObject({ lower: 0, upper: 1, baseline: 0.5 });
  expect(withRange(SHAPE, narrow, "gain", { upper: 2 })).toEqual({});
  const eco = withRange(SHAPE, {}, "mode", { choices: ["eco", "boost"] });
  expect(parameterRows(SHAPE, eco)[3]?.choices).toEqual(["eco", "boost"]);
  expect(withRange(SHAPE, eco, "mode", { choices: ["eco", "normal", "boost"] })).toEqual({});
  expect(parameterRows(SHAPE, withRange(SHAPE, {}, "gain", { upper: undefined }))[0]?.upper).toBeUndefined();
});

test("an entry of a curve stands for its coefficients until one of them is changed", () => {
  const curved: Shape = { ...SHAPE, parameters: [parameter("low", {}), parameter("high", {}), parameter("gain", {})], curves: { low: "slope", high: "slope" } };
  const given = { parameters: [{ name: "slope", lower: 0.5, upper: 1 }, { name: "gain", lower: 0, upper: 2, integer: true }] };
  expect(parameterRows(curved, given).map(({ lower, upper }) => [lower, upper])).toEqual([[0.5, 1], [0.5, 1], [0, 2]]);
  expect(withRange(curved, given, "gain", { upper: 1 })["parameters"]).toEqual([{ name: "slope", lower: 0.5, upper: 1 }, { name: "gain", lower: 0, upper: 1, integer: true, unit: "1" }]);
  expect(withRange(curved, given, "low", { upper: 0.9 })["parameters"]).toMatchObject([{ name: "low", upper: 0.9 }, { name: "high", upper: 1 }, { name: "gain" }]);
});

test("scenarios and weights are written where they differ, and one scenario is always left", () => {
  const winter = withScenario(SHAPE, withWeight({}, "spring", 3), "spring", false);
  expect(winter).toEqual({ catalogue: ["winter"] });
  expect(scenarioRows(SHAPE, winter).map((row) => row.used)).toEqual([true, false]);
  expect(withScenario(SHAPE, winter, "winter", false)).toEqual(winter);
  expect(withScenario(SHAPE, winter, "spring", true)).toEqual({});
  expect(withWeight(withWeight({}, "winter", 0), "winter", 1)).toEqual({});
});

test("another problem begins without what belonged to the one before", () => {
  const before: Wanted = { name: "a", problem: "x", weights: { S1: 2 }, fixed: { P1: 1 }, objectives: [{ score: "comfort" }], optimizer: { kind: "genetic", population: 20, start_sets: [{}] } };
  expect(withProblem(before, "heater")).toEqual({ name: "a", problem: "heater", optimizer: { kind: "genetic", population: 20 } });
  expect(withProblem(before, undefined)).toEqual({ name: "a", optimizer: { kind: "genetic", population: 20 } });
});

test("a clone with an analysis takes the reuse that goes with one, unless it was chosen", () => {
  const of = (spec: Record<string, unknown>, analysed = true, start?: unknown): Wanted => cloneOf({ name: "a", kind: "calibration", spec }, analysed, start);
  const reduction = { mode: "predicted", audit: 0.1, max_error: 0.02 };
  expect(of({ reduction, sensitivity: null })).toEqual({ name: "a again", sensitivity: {}, reduction: { audit: 0.1, max_error: 0.02 } });
  expect(of({ reduction: { ...reduction, mode: "exact" } })["reduction"]).toMatchObject({ mode: "exact" });
  expect(of({ reduction }, false)).toEqual({ name: "a again", reduction });
  expect(of({ reduction, sensitivity: { map: "m" } })).toMatchObject({ sensitivity: { map: "m" }, reduction });
  const twice = cloneOf({ name: "a", kind: "calibration", spec: {}, budget: { simulations: 300, minutes: null, stagnation: 5 } }, false, [{ P1: 1 }]);
  expect(twice["budget"]).toEqual({ simulations: 600, minutes: null, stagnation: 5 });
  expect(of({ optimizer: { kind: "genetic" } }, false, [{ P1: 1 }])["optimizer"]).toEqual({ kind: "genetic", start_sets: [{ P1: 1 }] });
});

test("a search starts with the set of a study or of a single evaluation, without their own settings", () => {
  const started = { name: "a again", problem: "p", optimizer: { start_sets: [{ P1: 1 }] } };
  const study = { problem: "p", optimizer: null, robustness: { of: "b" }, validation: null };
  expect(cloneOf({ name: "a", kind: "calibration", spec: study }, false, [{ P1: 1 }])).toEqual(started);
  expect(cloneOf({ name: "a", kind: "calibration", spec: study }, false)).toEqual({ ...study, name: "a again" });
  expect(cloneOf({ name: "a", kind: "evaluation", spec: { problem: "p", parameters: { P1: 1 }, scenario: "S1", seeds: 1, fresh: false } }, false, [{ P1: 1 }])).toEqual(started);
});

test("a set is checked in the vehicle of its variant, and not if its scenarios are of several", () => {
  const spec = { problem: "p", vehicle: { parameters: { mass: 1, grip: 2 } }, variants: { eu: { vehicle: { parameters: { mass: 3 } } } } };
  const check = (...scenarios: string[]): Wanted | null => checkOf({ spec }, { parameters: { P1: 1 }, scores: Object.fromEntries(scenarios.map((name) => [name, 1])) }, []);
  const own = { problem: "p", parameters: { P1: 1 }, fresh: true };
  expect(check("S1@eu")).toEqual({ ...own, scenario: "S1", vehicle: { parameters: { mass: 3, grip: 2 } } });
  expect(check("S1", "S2")).toEqual({ ...own, vehicle: { parameters: { mass: 1, grip: 2 } } });
  expect(check("S1@eu", "S1@us")).toBeNull();
});

test("a baseline is pasted as lines, between commas, from a table or as JSON", () => {
  const whole = { gain: 0.5, stage: 1, rooms: 3, mode: "boost" };
  for (const text of ["gain=0.5\nstage = 1\nrooms: 3\nmode=boost\n", "gain=0.5, stage=1, rooms=3, mode=boost", "gain\t0.5\nstage\t1\nrooms\t3\r\nmode\tboost", JSON.stringify(whole), JSON.stringify(whole, null, 2), "parameter,value,unit\ngain,0.5,W/K\nstage,1,kW\nrooms,3,1\nmode,boost,1\n"]) {
    expect(pastedSet(text, SHAPE.parameters)).toEqual({ values: whole, faults: [] });
  }
  expect(withBaselineOf({}, whole)).toEqual({ baseline: whole });
  expect(withBaselineOf({ baseline: whole }, {})).toEqual({});
});

test("what is not of the problem is named, and the rest is read", () => {
  const { values, faults } = pastedSet("gain=1e-1\nrooms=many\nstage=\nmode=fast\nwidth=2\nnonsense\nnonsense\ngain=0,5", SHAPE.parameters);
  expect(values).toEqual({ gain: 0.1 });
  expect(faults.map((fault) => fault.split(" ")[0])).toEqual(["rooms", "stage", "mode", "width", "nonsense", "gain"]);
});
