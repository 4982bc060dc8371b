import { expect, test, vi } from "vitest";
import { drawLines, heightOf, moved, opacity, valueAt, type Axis } from "./polylines";

const AXIS: Axis = { name: "P1", title: "P1", lower: -10, upper: 10 };

test("a height and its value belong together", () => {
  expect(valueAt(AXIS, heightOf(AXIS, 4))).toBeCloseTo(4);
  expect([valueAt(AXIS, -100), valueAt(AXIS, 10_000)]).toEqual([10, -10]);
});

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

test("few lines are strong, many are faint, and none is more than opaque", () => {
  expect([opacity(10), opacity(100_000) < 0.05]).toEqual([0.9, true]);
});

test("all lines come, over several frames, and those without a value have a gap", () => {
  const frames: FrameRequestCallback[] = [];
  vi.stubGlobal("requestAnimationFrame", (next: FrameRequestCallback) => frames.push(next));
  const drawn = { moveTo: 0, lineTo: 0 };
  const pen = { beginPath: () => undefined, stroke: () => undefined, moveTo: () => drawn.moveTo++, lineTo: () => drawn.lineTo++ } as unknown as CanvasRenderingContext2D;
  const values = Float64Array.from({ length: 5_000 }, (_, row) => (row === 7 ? Number.NaN : row % 10));
  const counts: number[] = [];
  drawLines(pen, [{ axis: AXIS, values }, { axis: AXIS, values }], 10, [{ rows: Uint32Array.from(values.keys()), style: "#000" }], (count) => counts.push(count));
  for (let now = 0; frames.length > 0; now += 16) frames.shift()?.(now);
  expect(counts.length).toBeGreaterThan(2);
  expect(counts.at(-1)).toBe(5_000);
  expect(drawn).toEqual({ moveTo: 4_999, lineTo: 4_999 });
  vi.unstubAllGlobals();
});

test("lines never take more than a frame of the screen for long, whether it shows 60 or 30 in a second", () => {
  // A browser that paints 100 lines in a millisecond, and a screen that shows a frame only at its own times.
  const longest = (refresh: number): number => {
    let next: FrameRequestCallback | null = null;
    vi.stubGlobal("requestAnimationFrame", (callback: FrameRequestCallback) => (next = callback));
    const pen = { beginPath: () => undefined, stroke: () => undefined, moveTo: () => undefined, lineTo: () => undefined } as unknown as CanvasRenderingContext2D;
    let sum = 0;
    let added = 0;
    drawLines(pen, [{ axis: AXIS, values: new Float64Array(60_000) }], 10, [{ rows: Uint32Array.from({ length: 60_000 }, (_, row) => row), style: "#000" }], (count) => ([added, sum] = [count - sum, count]));
    let [now, most] = [0, 0];
    while (next !== null) {
      const callback: FrameRequestCallback = next;
      next = null;
      callback(now);
      const took = Math.max(1, Math.ceil(added / 100 / refresh)) * refresh;
      [now, most] = [now + took, Math.max(most, took)];
    }
    expect(sum).toBe(60_000);
    vi.unstubAllGlobals();
    return most;
  };
  expect(longest(16)).toBe(32);
  expect(longest(32)).toBe(64);
});
