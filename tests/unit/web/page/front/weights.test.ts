import { expect, test } from "vitest";
import { leading, moved, normalised, shares, sums, weightsOf, weightsText } from "$lib/front/weights";
import WINNERS from "./winners.json";

const GOALS = [{ name: "comfort" }, { name: "jerk" }];

/** The server's tests read the same cases. */
test.each(WINNERS)("$about", ({ goals, objectives, weights, winner }) => {
  const rows = objectives.map((row) => ({ objectives: Object.fromEntries(goals.map(({ name }, place) => [name, row[place] as number])) }));
  expect(leading(sums(shares(rows, goals), weights), 1)).toEqual([winner]);
});

test("weights are written as the API reads them, also of names with a sign of equality", () => {
  expect(weightsText([0.25, 1 / 3], GOALS)).toBe("comfort=0.25,jerk=0.3333");
  expect(weightsOf("comfort=2", GOALS)).toEqual([2, 1]);
  expect(weightsOf("a=b=3", [{ name: "a=b" }])).toEqual([3]);
  expect([weightsOf(undefined, GOALS), weightsOf("comfort=0,jerk=0", GOALS)]).toEqual([null, null]);
  expect(weightsOf("comfort=-1,jerk=x", GOALS)).toEqual([1, 1]);
});

test("one weight moves, and the others keep their proportions", () => {
  expect(moved([0.5, 0.25, 0.25], 0, 0.1).map((weight) => Number(weight.toFixed(6)))).toEqual([0.6, 0.2, 0.2]);
  expect(moved([1, 0, 0], 0, -0.5)).toEqual([0.5, 0.25, 0.25]);
  expect(moved([0.5, 0.5], 1, 2)).toEqual([0, 1]);
  expect(normalised([0, 0])).toEqual([0.5, 0.5]);
});
