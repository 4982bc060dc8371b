import { expect, test, vi } from "vitest";
import { drawLines, moved, valueAt, type Axis } from "$lib/charts/polylines";

const AXIS: Axis = { name: "P1", title: "P1", lower: -10, upper: 10 };

test("a drag beyond the end of an axis takes the end itself, not what is left of it in floating point", () => {
  const axis = { ...AXIS, lower: -10, upper: 0.1 };
  expect(axis.lower + (axis.upper - axis.lower)).toBeLessThan(axis.upper);
  expect([valueAt(axis, -100), valueAt(axis, 10_000)]).toEqual([0.1, -10]);
});

test("keys move one end of a range, and never past the other or the axis", () => {
  expect(moved(AXIS, undefined, -1, "upper")).toEqual([-10, 9]);
  expect(moved(AXIS, [0, 0.5], -1, "upper")).toEqual([0, 0]);
  expect(moved(AXIS, [9.5, 10], 2, "lower")).toEqual([10, 10]);
  expect(moved(AXIS, [-Infinity, 3], -1, "lower")).toEqual([-10, 3]);
});

test("all lines come, over several frames, and those without a value have a gap", () => {
  const frames: (() => void)[] = [];
  vi.stubGlobal("requestAnimationFrame", (next: () => void) => frames.push(next));
  const drawn = { moveTo: 0, lineTo: 0, stroke: 0 };
  const pen = { beginPath: () => undefined, stroke: () => drawn.stroke++, moveTo: () => drawn.moveTo++, lineTo: () => drawn.lineTo++ } as unknown as CanvasRenderingContext2D;
  const values = Float64Array.from({ length: 5_000 }, (_, row) => (row === 7 ? Number.NaN : row % 10));
  drawLines(pen, [{ axis: AXIS, values }, { axis: AXIS, values }], 10, [{ rows: Uint32Array.from(values.keys()), style: "#000" }]);
  while (frames.length > 0) frames.shift()?.();
  expect(drawn).toEqual({ moveTo: 4_999, lineTo: 4_999, stroke: 10 });
  vi.unstubAllGlobals();
});
