import { expect, test } from "vitest";
import { overlay } from "./overlay";
import type { Generation } from "../server/types";

const generation = (iteration: number, best: number, requested: number, reused: number): Generation => ({ iteration, best, requested, reused, repeated: 0, predicted: 0 }) as Generation;
const searches = [
  { name: "first", generations: [generation(0, 4, 10, 0), generation(1, 5, 10, 6)] },
  { name: "other", generations: [generation(0, 3, 20, 0)] },
];

test("each search has its own places, over iterations or over simulations", () => {
  expect(overlay(searches, "iteration").map((line) => line.x)).toEqual([[1, 2], [1]]);
  expect(overlay(searches, "simulations").map((line) => line.x)).toEqual([[10, 14], [20]]);
});

test("searches differ in colour and dash, for eyes that see colours alike", () => {
  const [first, other] = overlay(searches, "iteration");
  expect(first?.colour).not.toBe(other?.colour);
  expect(first?.dash).not.toBe(other?.dash);
});
