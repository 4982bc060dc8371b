import { expect, test } from "vitest";
import type { Moving } from "../server/types";
import { leadingStage, parts, sentence, stagesOf, withoutSimulation } from "./words";

const cells = { proposed: 24, carried_over: 10, audited: 0, sampled: 1, unrepeatable: 0, unscored: 0, cut: 0, pending: 2, requested: 12, repeated: 1, reused: 2, predicted: 4, certified: 0, simulated: 4, failed: 1 };
const moving: Moving = {
  state: "running", requested_action: null, degraded: null, stage: "calibration", iteration: 3, progress: { done: 1, total: 2, eta_seconds: null },
  cells, stages: { calibration: cells }, seconds: { wall: 0, simulating: 0 },
};

test("the parts of what was requested are all of it", () => {
  expect(parts(moving.cells).reduce((sum, entry) => sum + entry.cells, 0)).toBe(moving.cells.requested);
});

test("predicted answers are among those without a simulation", () => {
  expect(withoutSimulation(moving.cells)).toBe(7);
  expect(withoutSimulation({})).toBe(0);
});

test("a sentence says what is going on, and what was asked for first", () => {
  expect(sentence(moving)).toBe("Searching: iteration 4.");
  expect(sentence({ ...moving, requested_action: "pause" })).toContain("Asked to pause");
  expect(sentence({ ...moving, state: "succeeded", stage: null })).toBe("Finished.");
});

test("only stages that asked for anything are shown", () => {
  expect(stagesOf(moving)).toEqual(["calibration"]);
  const study = { ...moving, stage: null, cells: { ...cells, proposed: 0 }, stages: { robustness: { ...cells, proposed: 5 } } };
  expect([leadingStage(moving), leadingStage(study)]).toEqual(["calibration", "robustness"]);
});
