import { describe, expect, test } from "vitest";
import { at, camera, lastBefore, ticks } from "$lib/charts/geometry";

const times = [0.1, 0.2, 0.3];

describe("a series", () => {
  test("is read between its values and not beyond them", () => {
    const values = [1, 3, 2];
    expect(at(times, values, 0)).toBe(1);
    expect(at(times, values, 0.15)).toBeCloseTo(2);
    expect(at(times, values, 0.3)).toBe(2);
    expect(at(times, values, 9)).toBe(2);
    expect(at(times, [], 1)).toBeNaN();
  });

  test("is found by bisection as by looking", () => {
    const many = Array.from({ length: 101 }, (_, index) => index / 10);
    for (let moment = -0.05; moment < 11; moment += 0.07) expect(lastBefore(many, moment)).toBe(many.filter((entry) => entry <= moment + 1e-9).length - 1);
  });
});

test("ahead is to the right and left is up, wherever the road turns", () => {
  for (const turn of [0, Math.PI / 2, -2]) {
    const ego = { x: 5, y: -3, heading: turn };
    const look = camera(ego, 2, [100, 50], turn);
    const [x, y] = look(5 + 10 * Math.cos(turn), -3 + 10 * Math.sin(turn));
    expect([x, y].map((entry) => Math.round(entry * 1e6) / 1e6)).toEqual([120, 50]);
    const [, left] = look(5 - Math.sin(turn), -3 + Math.cos(turn));
    expect(left).toBeCloseTo(48);
  }
});

test("ticks are round and within the ends", () => {
  expect(ticks(0, 7, 7)).toEqual([0, 1, 2, 3, 4, 5, 6, 7]);
  expect(ticks(-0.32, 0.3, 4)).toEqual([-0.2, 0, 0.2]);
  expect(ticks(3, 3, 5)).toEqual([3]);
});
