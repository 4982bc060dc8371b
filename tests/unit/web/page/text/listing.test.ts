import { expect, test } from "vitest";
import { arranged, countedCells, problemNameOf, savedShare, subjectOf } from "$lib/text/listing";
import type { Campaign } from "$lib/server/types";

const NONE = { proposed: 0, requested: 0, simulated: 0, repeated: 0, reused: 0, predicted: 0 };
function campaign(id: string, changes: Record<string, unknown> = {}): Campaign {
  return { id, name: id, kind: "calibration", state: "succeeded", spec: { optimizer: { kind: "genetic" } }, links: {}, best: null, cells: NONE, stages: {}, seconds: { wall: 1 }, created_at: "2026-01-01", tags: [], ...changes } as unknown as Campaign;
}
const shown = (listed: { campaign: Campaign; below: boolean }[]): string[] => listed.map((entry) => (entry.below ? `> ${entry.campaign.id}` : entry.campaign.id));

test("a validation belongs to the campaign that made its map", () => {
  const [maker, user] = [campaign("maker", { links: { influence_map: "/api/v1/influence-maps/m" } }), campaign("user", { links: { influence_map: "/api/v1/influence-maps/m" } })];
  const validation = campaign("v", { spec: { optimizer: null, validation: {}, sensitivity: { map: "m" } }, links: { influence_map: "/api/v1/influence-maps/m" } });
  expect(subjectOf(validation, [validation, user, maker])).toBe("maker");
  expect(subjectOf(validation, [validation])).toBeNull();
});

test("a search takes every word, in the name, the problem or the beginning of the id", () => {
  const known = [campaign("abc1", { name: "Highway comfort" }), campaign("abd2", { name: "heater", spec: { problem: "heater" } })];
  expect(shown(arranged(known, "comfort high", ["created", "down"]))).toEqual(["abc1"]);
  expect(shown(arranged(known, "abd", ["created", "down"]))).toEqual(["abd2"]);
  expect(arranged(known, "high heater", ["created", "down"])).toEqual([]);
});

test("a search takes words of settings: optimizer, mode, objectives", () => {
  const known = [campaign("a", { spec: { optimizer: { kind: "nsga2" }, reduction: { mode: "both" }, objectives: [{ measure: "energy_kwh" }] } }), campaign("b", { spec: { optimizer: { kind: "genetic" }, reduction: { mode: "predicted" } } })];
  expect(["nsga2 both", "energy", "predicted", "nsga2 predicted"].map((search) => shown(arranged(known, search, ["created", "down"])))).toEqual([["a"], ["a"], ["b"], []]);
});

test("a problem has the name of its push, and none if the list leaves the specification out", () => {
  const [digest, pushed] = ["0123456789abcdef", [{ name: "heater", digest: "0123456789abcdef" }]];
  expect([digest, "another-digest-of-one", "highway", undefined].map((problem) => problemNameOf({ spec: { problem } }, pushed))).toEqual(["heater", "another-dige", "highway", ""]);
});

test("columns sort both ways, and a missing best comes last in both", () => {
  const known = [campaign("a", { best: { objective: 2 } }), campaign("b"), campaign("c", { best: { objective: 5 } })];
  expect(shown(arranged(known, "", ["best", "down"]))).toEqual(["c", "a", "b"]);
  expect(shown(arranged(known, "", ["best", "up"]))).toEqual(["a", "c", "b"]);
  expect(shown(arranged(known, "", ["name", "down"]))).toEqual(["c", "b", "a"]);
});

test("a study counts the cells of its stages", () => {
  const made = campaign("s", { stages: { robustness: { ...NONE, requested: 10, simulated: 4, repeated: 6 } } });
  expect(countedCells(made)).toMatchObject({ requested: 10, simulated: 4 });
  expect(savedShare(made)).toBeCloseTo(0.6);
  expect(savedShare(campaign("new"))).toBeNull();
});
