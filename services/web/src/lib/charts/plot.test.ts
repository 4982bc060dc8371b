import { expect, test } from "vitest";
import { across, floors, legend, logTicks, numbersOf, outline, reach, scales, spansDecades, valueNear, type Frame, type Series } from "./plot";

const FRAME: Frame = { width: 120, height: 70, left: 10, right: 10, top: 10, bottom: 10, x: [0, 10], y: [0, 5], log: false };
const line = (values: (number | null)[], more: Partial<Series> = {}): Series => ({ name: "a", values, colour: "#000000", ...more });

test("a line goes through its values and leaves out what is not there", () => {
  expect(outline(line([0, null, 5]), [0, 5, 10], [], false, FRAME)).toBe("M10.0 60.0L110.0 10.0");
});

test("steps hold a value until the next, at places of their own", () => {
  expect(outline(line([0, 5], { steps: true, x: [5, 10] }), [0, 1], [], false, FRAME)).toBe("M60.0 60.0L110.0 60.0L110.0 10.0");
});

test("a single value is a mark in the middle, of lines as of areas", () => {
  expect(outline(line([null, 5]), [0, 5], [], false, FRAME)).toBe("M53.0 10.0L67.0 10.0");
  expect(outline(line([5], { kind: "area" }), [5], [0], true, FRAME)).toBe("M53.0 10.0L67.0 10.0L67.0 60.0L53.0 60.0Z");
  expect([across([3], [line([1])], 0), across([1, 3], [line([1, 2])], 0)]).toEqual([[2.5, 3.5], [1, 3]]);
});

test("on a logarithmic scale each decade is as high as the next, and nothing lies below the ground", () => {
  const { py } = scales({ ...FRAME, y: [1, 100], log: true });
  expect([py(0), py(1), py(10), py(100)]).toEqual([60, 60, 35, 10]);
  expect(logTicks(0.7, 2000)).toEqual([1, 10, 100, 1000]);
  expect(logTicks(0.7, 16)).toEqual([1, 2, 5, 10]);
});

test("areas lie on each other and stand on the ground", () => {
  const areas: Series[] = [line([1, 2], { kind: "area" }), line([3, 4], { kind: "area" })];
  const below = floors(areas, 2, true);
  expect(below).toEqual([[0, 0], [1, 2]]);
  expect(reach(areas, below, false)[0]).toBe(0);
  expect(reach(areas, below, false)[1]).toBeGreaterThan(6);
});

test("counts of one size need no logarithmic scale", () => {
  expect([spansDecades([0, 3, 9]), spansDecades([0, 1, 900]), spansDecades([900])]).toEqual([false, true, false]);
});

test("runs of one group have one entry in the legend", () => {
  expect(legend([line([], { group: "x" }), line([], { group: "x" }), line([])]).length).toBe(2);
});

test("lines with places of their own are read at those, and nowhere else", () => {
  const line = (x: number[], values: number[]): Series => ({ name: "v", colour: "", x, values });
  const longest = [0, 1, 2, 3, 4];
  expect([0.9, 2.2, 3].map((moment) => valueNear(line([0, 2], [5, 7]), longest, moment))).toEqual([5, null, null]);
  expect([valueNear({ name: "v", colour: "", values: [1, 2, 3, 4, 5] }, longest, 2.6), valueNear(line([], []), longest, 1), valueNear(line([0, 0.5, 1], [1, 2, 3]), longest, 1)]).toEqual([4, null, 3]);
  expect(numbersOf([line([0, 2], [5, 7])], longest, "time / s", "m")).toEqual({ head: ["line", "time / s", "m"], rows: [["v", 0, 5], ["v", 2, 7]] });
});
