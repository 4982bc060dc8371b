import { expect, test } from "vitest";

import { needsOf, visitAt } from "./news";
import type { Campaign, ResultTrust } from "../server/types";

const HOUR = 3_600_000;
const ended = (id: string, at: number, objective: number, best: object = {}): Campaign => ({
  id, kind: "calibration", state: "succeeded", spec: { problem: "p", optimizer: { kind: "genetic" } }, scale: { direction: "maximise", tolerance: 0 }, started_at: "1970-01-01", ended_at: new Date(at).toISOString(),
  best: { objective, violation: 0, undecided: false, scores: { S1: objective }, parameters: {}, ...best },
}) as unknown as Campaign;
const TRUST = { a: { verdicts: [{ code: "constraints_undecided", light: "amber", question: "scores", text: "not decided" }] } } as unknown as Record<string, ResultTrust>;

test("a set whose rates are undecided is doubtful, and one that breaks constraints is not feasible", () => {
  const kinds = (best: object): string[] => needsOf([ended("a", HOUR, 1, best)], 0, TRUST).map(({ kind }) => kind);
  expect(kinds({ violation: 0.0009, undecided: true })).toEqual(["doubtful"]);
  expect(kinds({ violation: 0.0009 })).toEqual(["nothing feasible"]);
});

test("a visit goes on until an hour out of sight, and begins at the last sight", () => {
  const now = 100 * HOUR;
  expect(visitAt(`${now - HOUR} ${now - 1}`, now).since).toBe(now - HOUR);
  expect(visitAt(`${now - 9 * HOUR} ${now - 2 * HOUR}`, now).since).toBe(now - 2 * HOUR);
  expect(visitAt(null, now)).toMatchObject({ since: now - 24 * HOUR, known: false });
});
