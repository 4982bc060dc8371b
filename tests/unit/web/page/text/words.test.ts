import { expect, test } from "vitest";
import { brokenText, intervalText, regionText, seedsText, sentence } from "$lib/text/words";

test("a map says nothing of values outside its space", () => {
  const text = (region: string, other: string, lower: number | null, upper: number | null): string => regionText({ region, reference_region: other, lower, upper } as Parameters<typeof regionText>[0]);
  expect([text("outside", "anywhere", null, null), text("below", "outside", 1, 2)]).toEqual(Array.from({ length: 2 }, () => "nothing: a value lies outside its space"));
  expect([text("anywhere", "anywhere", null, null), text("influential", "influential", null, null)]).toEqual(["matters nowhere", "matters everywhere"]);
  expect([text("below", "influential", 1, 2), text("influential", "above", null, 2)]).toEqual(["matters from 1 up to 2", "matters up to 2"]);
});

test("a set says by how much it breaks constraints, or that its runs do not tell", () => {
  expect([brokenText({ violation: 0, undecided: false }), brokenText({ violation: 0.031, undecided: false }), brokenText({ violation: 1e-9, undecided: true })]).toEqual(["", "breaks constraints by 3.1 %", "not known to keep its rates"]);
});

test("an interval may lack an end", () => {
  expect([intervalText({ lower: 1.25, upper: 2 }), intervalText({ lower: null, upper: 2 }), intervalText({ lower: null, upper: null })]).toEqual(["1.25 to 2", "unknown to 2", ""]);
});

test("many seeds of a set are counted", () => {
  expect([[121], [1, 2], [1, 2, 3, 4, 5, 6]].map(seedsText)).toEqual(["under seed 121", "under seeds 1, 2", "under its 6 seeds"]);
});

test("a search without a result waits for its workers", () => {
  const text = (done: number): string => sentence({ state: "running", requested_action: null, stage: "calibration", iteration: 4, budget: {}, progress: { done, total: 500 } } as unknown as Parameters<typeof sentence>[0]);
  expect([text(0), text(1)]).toEqual(["Waiting for the workers' first results.", "Searching: round 5."]);
});
