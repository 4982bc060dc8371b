import { expect, test } from "vitest";
import { envelope, nearest, thinned } from "./scatter";

const ROWS = Uint32Array.of(0, 1, 2, 3, 4);
const XS = Float64Array.of(0, 1, 5, 9, 10);
const YS = Float64Array.of(3, 4, Number.NaN, 1, 2);

test("many rows are thinned evenly, few are left as they are", () => {
  expect([...thinned(Uint32Array.from({ length: 10 }, (_, row) => row), 5)]).toEqual([0, 2, 4, 6, 8]);
  expect(thinned(ROWS, 5)).toBe(ROWS);
});

test("the envelope holds the best of each part of the axis, by the direction of the score", () => {
  const axis = { lower: 0, upper: 10 };
  expect(envelope(ROWS, XS, YS, axis, 1, 2)).toEqual([[2.5, 4], [7.5, 2]]);
  expect(envelope(ROWS, XS, YS, axis, -1, 2)).toEqual([[2.5, 3], [7.5, 1]]);
});

test("of choices every one has a part of its own", () => {
  expect(envelope(Uint32Array.of(0, 1, 2), Float64Array.of(0, 2, 2), Float64Array.of(1, 5, 6), { lower: 0, upper: 2, choices: ["a", "b", "c"] }, 1)).toEqual([[0, 1], [2, 6]]);
});

test("the nearest point within reach is chosen", () => {
  const [px, py] = [(row: number): number => XS[row] ?? 0, (row: number): number => YS[row] ?? 0];
  expect(nearest(ROWS, px, py, 9.4, 1.2, 2)).toBe(3);
  expect(nearest(ROWS, px, py, 50, 50, 2)).toBeNull();
});
