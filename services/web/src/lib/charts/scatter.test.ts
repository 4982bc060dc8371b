import { expect, test } from "vitest";
import { nearest, thinned } from "./scatter";

const ROWS = Uint32Array.of(0, 1, 2, 3, 4);
const XS = Float64Array.of(0, 1, 5, 9, 10);
const YS = Float64Array.of(3, 4, Number.NaN, 1, 2);

test("many rows are thinned evenly, few are left as they are", () => {
  expect([...thinned(Uint32Array.from({ length: 10 }, (_, row) => row), 5)]).toEqual([0, 2, 4, 6, 8]);
  expect(thinned(ROWS, 5)).toBe(ROWS);
});

test("the nearest point within reach is chosen", () => {
  const [px, py] = [(row: number): number => XS[row] ?? 0, (row: number): number => YS[row] ?? 0];
  expect(nearest(ROWS, px, py, 9.4, 1.2, 2)).toBe(3);
  expect(nearest(ROWS, px, py, 50, 50, 2)).toBeNull();
});
