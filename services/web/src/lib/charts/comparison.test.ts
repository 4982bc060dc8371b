import { expect, test } from "vitest";
import { lines, span } from "./comparison";
import type { ComparedRun } from "../server/types";

const run = (campaign: string, optimizer: string, population: number, reduction: string, bests: number[]): ComparedRun =>
  ({ campaign, optimizer, population, reduction, course: bests.map((best, place) => ({ iteration: place + 1, simulations: 5 * (place + 1), best, rating: best / 2 })) }) as ComparedRun;
const RUNS = [run("a", "genetic", 40, "off", [5, 6]), run("b", "genetic", 80, "exact", [5]), run("c", "swarm", 40, "off", [])];

test("every run of an optimizer is a line, with a group for each population and reduction", () => {
  const drawn = lines(RUNS, "genetic", "best", "iteration");
  expect(drawn.map((entry) => [entry.name, entry.group, entry.values, entry.x])).toEqual([
    ["a", "40 individuals, off", [5, 6], [1, 2]],
    ["b", "80 individuals, exact", [5], [1]],
  ]);
  expect(drawn[0]?.colour).not.toBe(drawn[1]?.colour);
  expect(drawn[0]?.shift).toBe(-(drawn[1]?.shift ?? 0));
  expect(lines(RUNS, "genetic", "rating", "simulations")[0]).toMatchObject({ x: [5, 10], values: [2.5, 3] });
});

test("a run without an iteration has no line", () => {
  expect(lines(RUNS, "swarm", "best", "iteration")).toEqual([]);
});

test("equal values have room around them", () => {
  expect([span([6, 6, null]), span([])]).toEqual([[5.5, 6.5], [0, 1]]);
});
