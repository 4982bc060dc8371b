import { expect, test } from "vitest";
import { gridOf, parts } from "./fields";

const AXIS = { lower: 0, upper: 12 };
const rows = (length: number): Uint32Array => new Uint32Array(length).map((_, row) => row);

test("parts are equal and end at the ends; choices have a part each", () => {
  expect(parts(AXIS)).toEqual([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
  expect(parts({ lower: 0.1, upper: 0.7 }).at(-1)).toBe(0.7);
  expect(parts({ lower: 0, upper: 1, choices: ["a", "b"] })).toEqual([-0.5, 0.5, 1.5]);
});

test("a field has the mean, the best and the number of its rows, and no field without a row", () => {
  const xs = Float64Array.of(0.5, 0.9, 12, 3, NaN);
  const ys = Float64Array.of(0.5, 0.1, 12, 3, 1);
  const values = Float64Array.of(2, 4, 9, NaN, 1);
  const grid = gridOf(rows(5), xs, ys, values, AXIS, AXIS, 1);
  expect(grid.fields).toEqual([
    { column: 0, line: 0, rows: 2, mean: 3, best: 4, across: [0.5, 0.9], up: [0.1, 0.5] },
    { column: 11, line: 11, rows: 1, mean: 9, best: 9, across: [12, 12], up: [12, 12] },
  ]);
  expect(grid.left).toBe(2);
  expect(gridOf(rows(2), xs, ys, values, AXIS, AXIS, -1).fields[0]?.best).toBe(2);
});

test("the range of a field has its rows alone, also if those of the next lie on the end between both", () => {
  const on = Float64Array.of(1, 1.5, 2, 3);
  const { fields } = gridOf(rows(4), on, on, on, AXIS, AXIS, 1);
  for (const { across: [low, high], rows: count } of fields) expect(on.filter((value) => value >= low && value <= high)).toHaveLength(count);
});
