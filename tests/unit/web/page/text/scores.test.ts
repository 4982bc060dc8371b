import { expect, test } from "vitest";
import { offeredScores } from "$lib/text/scores";
import type { ProblemAnswer, Scale } from "$lib/server/types";

const COST = { formula: "e", direction: "minimise", range: [0, 100], tolerance: 2, failed: null, unit: "EUR" };
const EASE = { formula: "10 - e", direction: "maximise", range: [0, 10], tolerance: 0, failed: null, unit: "1" };
const SCALE: Scale = { name: "cost", direction: "minimise", lower: 0, upper: 100, tolerance: 2, failed: 100, step: null, unit: "EUR" };

function pushed(digest: string, scores: ProblemAnswer["scores"]): ProblemAnswer {
  return {
    name: "heater", digest, size: 1, latest: true, created_at: "2026-01-01T00:00:00Z", links: {}, description: "", parameters: {}, shapes: {}, varied: {}, constraints: [],
    baseline: null, simulator: { kind: "command" }, scenarios: {}, measures: {}, failures: [], series: {}, scores, notes: [],
  };
}
const OWN = pushed("d1", { cost: COST, ease: EASE });
const campaign = (spec: Record<string, unknown> = {}): { spec: Record<string, unknown>; scale: Scale } => ({ spec: { evaluator: "cost", ...spec }, scale: SCALE });

test("of the latest push those are offered that give other numbers", () => {
  const latest = pushed("d2", { cost: { ...COST, formula: "2*e" }, ease: { ...EASE, range: [0, 10], tolerance: 1 }, new: EASE });
  const values = offeredScores(campaign(), OWN, latest).map((score) => score.value);
  expect(values).toEqual(["", "ease", "cost@d2", "new@d2"]);
  expect(offeredScores(campaign(), OWN, { ...latest, scores: OWN.scores }).map((score) => score.value)).toEqual(["", "ease"]);
});
