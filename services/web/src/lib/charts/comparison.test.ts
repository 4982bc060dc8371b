import { expect, test } from "vitest";
import { lines, span } from "./comparison";
import type { ComparedRun, Generation } from "../server/types";

const run = (id: string, optimizer: string, population: number, reduction: string): ComparedRun =>
  ({ run: id, optimizer, population, reduction, seed: 1, state: "succeeded" }) as ComparedRun;
const generation = (iteration: number, best: number): Generation => ({ iteration, best, rating: best / 2, requested: 14, repeated: 2, reused: 3, predicted: 4 }) as Generation;
const RUNS = [run("a", "genetic", 40, "off"), run("b", "genetic", 80, "exact"), run("c", "swarm", 40, "off")];
const FOUND = { a: [generation(0, 5), generation(1, 6)], b: [generation(0, 5)], c: [] };

test("every run of an optimizer is a line, with a group for each population and reduction", () => {
  const drawn = lines(RUNS, "genetic", FOUND, "best", "iteration");
  expect(drawn.map((entry) => [entry.name, entry.group, entry.values, entry.x])).toEqual([
    ["a", "40 individuals, off", [5, 6], [1, 2]],
    ["b", "80 individuals, exact", [5], [1]],
  ]);
  expect(drawn[0]?.colour).not.toBe(drawn[1]?.colour);
  expect(drawn[0]?.shift).toBe(-(drawn[1]?.shift ?? 0));
});

test("what was repeated, reused or predicted took no simulation", () => {
  expect(lines(RUNS, "genetic", FOUND, "rating", "simulations")[0]).toMatchObject({ x: [5, 10], values: [2.5, 3] });
});

test("a run without an iteration has no line", () => {
  expect(lines(RUNS, "swarm", FOUND, "best", "iteration")).toEqual([]);
});

test("equal values have room around them", () => {
  expect([span([6, 6, null]), span([])]).toEqual([[5.5, 6.5], [0, 1]]);
});
