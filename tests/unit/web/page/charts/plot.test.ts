import { expect, test } from "vitest";
import { density, likeness, marked, numbersOf, outline, reach, room, slice, valueNear, type Frame, type Series } from "$lib/charts/plot";

const FRAME: Frame = { width: 120, height: 70, left: 10, right: 10, top: 10, bottom: 10, x: [0, 10], y: [0, 5] };
const line = (values: (number | null)[], more: Partial<Series> = {}): Series => ({ name: "a", values, colour: "#000000", ...more });

test("a line goes through its values, leaves out what is not there, and marks a single value", () => {
  expect(outline(line([0, null, 5]), [0, 5, 10], FRAME)).toBe("M10.0 60.0L110.0 10.0");
  expect(outline(line([0, 5], { steps: true, x: [5, 10] }), [0, 1], FRAME)).toBe("M60.0 60.0L110.0 60.0L110.0 10.0");
  expect(outline(line([null, 5]), [0, 5], FRAME)).toBe("M53.0 10.0L67.0 10.0");
  expect([reach([[3], [null]]), reach([[1, 3], [2]], 0), reach([])]).toEqual([[2.5, 3.5], [1, 3], [0, 1]]);
});

test("marks of an axis keep their digits, and have room for them", () => {
  expect([0.5325, 123457.325, 20_000, 1e-7].map(marked)).toEqual(["0.5325", "123457.325", "20,000", "1e-7"]);
  expect([room([]), room(["1"]), room(["123457.325"]), room(["x".repeat(99)])]).toEqual([50, 50, 87, 160]);
});

test("lines with places of their own are read at those, and nowhere else", () => {
  const longest = [0, 1, 2, 3, 4];
  const own = line([5, 7], { name: "v", x: [0, 2] });
  expect([0.9, 2.2, 3].map((moment) => valueNear(own, longest, moment))).toEqual([5, null, null]);
  expect([valueNear(line([1, 2, 3, 4, 5]), longest, 2.6), valueNear(line([], { x: [] }), longest, 1)]).toEqual([4, null]);
  expect(numbersOf([own], longest, "time / s", "m")).toEqual({ head: ["line", "time / s", "m"], rows: [["v", 0, 5], ["v", 2, 7]] });
});

test("a violin has its mass where the values are", () => {
  const fields = density([2, 2, 2, 2, 8], 0, 10, 100);
  const mass = (some: readonly number[]): number => some.reduce((sum, value) => sum + value, 0);
  expect(mass(fields.slice(0, 50)) / mass(fields)).toBeGreaterThan(0.7);
  expect(fields.indexOf(Math.max(...fields))).toBeCloseTo(20, -1);
  expect(density([], 0, 1, 3)).toEqual([0, 0, 0]);
});

test("a slice is made of the sets that are like the first one", () => {
  const near = likeness([{ shares: [0.5, 0.5, 0.9, 0.5], isChoice: false }, { shares: [1, 1, 1, 0], isChoice: true }], 4);
  expect([near[0], near[1]]).toEqual([1, 1]);
  expect(Math.max(near[2] ?? 1, near[3] ?? 1)).toBeLessThan(0.5);
  const line = slice([0.1, 0.1, 0.15, 0.1], [4, 6, 100, 100], [1, 1, 0.001, 0.001], 10);
  expect(line[0]).toBeCloseTo(5, 0);
  expect(line[9]).toBeNull();
});
