import { expect, test } from "vitest";
import { barsOf } from "./differences";

const COMFORT = { lower: 0, upper: 7, tolerance: 1 };
const COST = { lower: 0, upper: 100, tolerance: 2 };

test("comfort has a bar for each point", () => {
  const { places, wrong, counts, beyond } = barsOf([{ histogram: { "0": 90, "-1": 4, "2": 5, "-7": 1 }, histogram_step: 1 }], COMFORT);
  expect(places).toEqual([-7, -6, -5, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5, 6, 7]);
  expect(counts).toEqual([[1, 0, 0, 0, 0, 0, 4, 90, 0, 5, 0, 0, 0, 0, 0]]);
  expect(wrong.filter((is) => !is)).toHaveLength(3);
  expect(beyond).toBe(false);
});

test("only the middle bar of costs without steps is right, and the outermost hold the rest", () => {
  const { places, wrong, counts, beyond } = barsOf([{ histogram: { "0": 9, "26": 1 }, histogram_step: 4 }], COST);
  expect(places.filter((_, index) => !wrong[index])).toEqual([0]);
  expect([places.length, counts[0]?.at(-1), beyond]).toEqual([53, 1, true]);
});

test("many differences do not fill the memory", () => {
  const { places, counts } = barsOf([{ histogram: { "-2000000000": 1, "1000000000": 2, "500": 3 }, histogram_step: 1e-6 }], COST);
  expect(places).toHaveLength(203);
  expect([counts[0]?.[0], counts[0]?.at(-1)]).toEqual([1, 5]);
});

test("nothing was compared", () => {
  expect(barsOf([], COMFORT).counts).toEqual([]);
});
