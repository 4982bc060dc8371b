import { expect, test } from "vitest";

import { betterSince, needsOf, visitAt } from "$lib/text/news";
import type { Campaign, ResultTrust } from "$lib/server/types";

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

test("a range is widened in the form, or where the problem limits it by a push", () => {
  const need = (entries: string[]): unknown => {
    const verdict = { code: "at_ends", light: "amber", question: "search", text: "", numbers: { entries } };
    return needsOf([ended("a", HOUR, 1)], 0, { a: { verdicts: [verdict] } } as unknown as typeof TRUST)[0]?.path;
  };
  expect([need([]), need(["`upper: 3` of P2"])]).toEqual([["submit"], ["problems"]]);
});

test("campaigns that one cause keeps are one need", () => {
  const degraded = (id: string): Campaign => ({ ...ended(id, 0, 1), state: "queued", ended_at: null, degraded: "silent" }) as unknown as Campaign;
  expect(needsOf([degraded("b"), degraded("a")], 0, {}).map(({ campaign, kind }) => [campaign.id, kind])).toEqual([["b", "degraded"]]);
});

test("a new campaign is better than older ones of its question, else than its baseline", () => {
  const better = (...known: Campaign[]): unknown[] => betterSince(known, 10 * HOUR).map(({ campaign, before, of, scenario }) => [campaign.id, before, of?.id, scenario]);
  const [old, fresh] = [ended("old", HOUR, 5), ended("new", 11 * HOUR, 6)];
  expect(better(fresh, old, ended("worse", 11 * HOUR, 5.5), ended("older", HOUR, 4))).toEqual([["new", 5, "old", "S1"]]);
  expect(better(ended("new", 11 * HOUR, 5), old)).toEqual([]);
  expect(better({ ...fresh, spec: { ...fresh.spec, weights: { S1: 2 } } }, old)).toEqual([]);
  expect(better({ ...fresh, baseline: { objective: 4, scores: { S1: 4 } } } as unknown as Campaign)).toEqual([["new", 4, undefined, "S1"]]);
  expect(better({ ...fresh, scale: { ...fresh.scale, tolerance: 1 } }, { ...old, scale: { ...old.scale, tolerance: 1 } })).toEqual([]);
  expect(better(...[fresh, old].map((campaign) => ({ ...campaign, scale: { ...campaign.scale, direction: "minimise" } }) as Campaign))).toEqual([]);
});

test("a set is not called better if its runs leave that open", () => {
  const better = (...known: Campaign[]): string[] => betterSince(known, 10 * HOUR).map(({ campaign }) => campaign.id);
  const sure = ended("new", 11 * HOUR, 6, { lower: 5.6, upper: 6.4 });
  expect(better(sure, ended("old", HOUR, 5, { lower: 4.5, upper: 5.5 }))).toEqual(["new"]);
  expect(better(sure, ended("old", HOUR, 5, { lower: 4.3, upper: 5.7 }))).toEqual([]);
  expect(better({ ...sure, baseline: { objective: 4, scores: {}, close: true } } as unknown as Campaign)).toEqual([]);
  const several = { ...sure, best: { ...sure.best, replicates: 4 } };
  const beside = (gain: number | null): string[] => better({ ...several, baseline: { objective: 4, scores: {}, close: false, gain } } as unknown as Campaign);
  expect([beside(2), beside(null)]).toEqual([["new"], []]); // without equal seeds nothing compares them
});

test("a visit goes on until an hour out of sight, and begins at the last sight", () => {
  const now = 100 * HOUR;
  expect(visitAt(`${now - HOUR} ${now - 1}`, now).since).toBe(now - HOUR);
  expect(visitAt(`${now - 9 * HOUR} ${now - 2 * HOUR}`, now).since).toBe(now - 2 * HOUR);
  expect(visitAt(null, now)).toMatchObject({ since: now - 24 * HOUR, known: false });
});
