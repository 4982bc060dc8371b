import { expect, test } from "vitest";
import { changeOf, gain, signed } from "$lib/text/scores";

test("a gain is what is better, whichever direction that is", () => {
  expect([gain(31, 50, true), gain(6, 5, false), gain(4, 5, false), gain(6, null, false), gain(undefined, 5, true)]).toEqual([19, 1, -1, null, null]);
});

test("a gain or a loss within the tolerance is neither better nor worse", () => {
  expect([0.5, 1, -1, 1.5, -1.5, 0].map((value) => changeOf(value, 1))).toEqual(["within", "within", "within", "better", "worse", "equal"]);
  expect([0.1 + 0.2 - 0.3, 0.01].map((value) => changeOf(value, 0))).toEqual(["equal", "better"]);
  expect(changeOf(0.3 - 0.1, 0.2)).toBe("within");
  expect([signed(2, "2"), signed(-2, "2"), signed(0, "0")]).toEqual(["+2", "−2", "0"]);
});
