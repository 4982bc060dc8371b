import { expect, test } from "vitest";
import type { Trace } from "./geometry";
import { SERIES } from "./palette";
import { HEIGHT, colours, seen, svgOf, type Scene, type Shape } from "./road";

const along = Array.from({ length: 60 }, (_, index) => index * 5);
const SCENE: Scene = {
  road: { length_m: 295, lanes: 2, lane_width_m: 4, reference_line: along.map((x) => [x, x, 0, 0, 0]), boundaries: [-2, 2, 6].map((y) => along.map((x) => [x, y])) },
  ego: { length_m: 5, width_m: 2 },
  traffic: [{ id: "a<b", length_m: 10, width_m: 2 }],
  duration: 2,
};
const moving = (from: number) => ({ x_m: [from, from + 30, from + 60], y_m: [0, 0, 0], heading_rad: [0, 0, 0] });
const TRACE: Trace = {
  scenario: "S1", score: 7, rating: 6.9, failure: null, time_s: [0, 1, 2], ego: moving(100), neighbours: { "a<b": moving(120), gone: { x_m: [], y_m: [] } },
  plans: [{ made_at_s: 1, x_m: [130, 160], y_m: [0, 1] }],
};
const at = (moment: number): Shape[] => seen(TRACE, SCENE, moment, 800, colours(false));
const strokes = (shapes: Shape[], colour: string): Shape[] => shapes.filter((shape) => "points" in shape && shape.stroke === colour);

test("the road has two edges and a dashed line between its lanes", () => {
  const shapes = at(0);
  expect(shapes.filter((shape) => "points" in shape && shape.dash).length).toBe(1);
  expect(strokes(shapes, "#ffffff").length).toBe(3);
});

test("dashes stay where they are on the road while the view moves", () => {
  const [first, other] = [at(0), at(0.5)].map((shapes) => shapes.find((shape) => "points" in shape && shape.dash));
  if (!first || !other || !("points" in first) || !("points" in other)) throw new Error("no dashes");
  const scale = (first.dash?.[0] ?? 0) / 6;
  const start = (path: typeof first): number => (path.points[0]?.[0] ?? 0) - (path.dashOffset ?? 0);
  expect(start(first) - start(other)).toBeCloseTo(15 * scale);
});

test("a plan is there once it was made, and who is not on the road is not drawn", () => {
  expect(strokes(at(0.5), "#d55e00").length).toBe(0);
  expect(strokes(at(1), "#d55e00").length).toBe(1);
  expect(at(0).filter((entry) => "text" in entry).map((entry) => ("text" in entry ? entry.text : ""))).toEqual(["a<b"]);
});

test("as an SVG it has the size of the view, and names cannot break it", () => {
  const written = svgOf(at(1), 800);
  expect(written).toContain(`viewBox="0 0 800 ${HEIGHT}"`);
  expect(written).toContain(">a&lt;b</text>");
  expect(written).not.toContain("NaN");
});

test("an ego vehicle beside another has its own colour, which its plan never has", () => {
  for (const dark of [false, true]) {
    const cars = SERIES.slice(0, 2).map((own) => colours(dark, own));
    expect(new Set(cars.map(({ ego }) => ego)).size).toBe(2);
    for (const { ego, way, plan } of cars) expect([way === ego, plan === ego]).toEqual([true, false]);
  }
  const drawn = seen(TRACE, SCENE, 0, 800, colours(false, SERIES[1]));
  expect(strokes(drawn, SERIES[1] ?? "").length).toBeGreaterThan(0);
  expect(strokes(drawn, colours(false).ego)).toEqual([]);
});
