import { expect, test } from "vitest";
import { changeOf, courseOf, gain, signed } from "./course";

const GENERATIONS = [{ iteration: 0, best: 40, mean: 70 }, { iteration: 1, best: 31, mean: 55 }, { iteration: 2, best: null, mean: null }];

test("a search is drawn over its finished iterations, beside the baseline", () => {
  const { x, series } = courseOf(GENERATIONS, 50);
  expect(x).toEqual([1, 2]);
  expect(series.map((line) => [line.name, line.values])).toEqual([["best so far", [40, 31]], ["mean of the iteration", [70, 55]], ["baseline", [50, 50]]]);
  expect(courseOf(GENERATIONS, null).series.length).toBe(2);
});

test("a gain is what is better, whichever direction that is", () => {
  expect([gain(31, 50, true), gain(6, 5, false), gain(4, 5, false), gain(6, null, false), gain(undefined, 5, true)]).toEqual([19, 1, -1, null, null]);
});

test("a gain or a loss within the tolerance is neither better nor worse", () => {
  expect([0.5, 1, -1, 1.5, -1.5, 0].map((value) => changeOf(value, 1))).toEqual(["within", "within", "within", "better", "worse", "equal"]);
  expect([0.1 + 0.2 - 0.3, 0.01].map((value) => changeOf(value, 0))).toEqual(["equal", "better"]);
  expect(changeOf(0.3 - 0.1, 0.2)).toBe("within");
  expect([signed(2, "2"), signed(-2, "2"), signed(0, "0")]).toEqual(["+2", "−2", "0"]);
});
