import { expect, test } from "vitest";
import { byMeasure, courseOf, haveLikeScores, overOf, overlay, placesOf, type Over } from "$lib/charts/overlay";
import type { Campaign, Generation } from "$lib/server/types";

const generation = (iteration: number, best: number, requested: number, reused: number): Generation => ({ iteration, best, requested, reused, repeated: 0, predicted: 0 }) as Generation;
const searches = [
  { name: "first", place: 0, generations: [generation(0, 4, 10, 0), generation(1, 5, 10, 6)] },
  { name: "other", place: 1, generations: [generation(0, 3, 20, 0)] },
];

test("a search is drawn over iterations, one with a budget over the simulations so far", () => {
  expect(["iteration", "simulations"].map((over) => searches.map(({ generations }) => placesOf(generations, over as Over)))).toEqual([[[1, 2], [1]], [[10, 14], [20]]]);
  expect([overOf([{ budget: null }]), overOf([{ budget: null }, { budget: { simulations: 60 } }])]).toEqual(["iteration", "simulations"]);
});

test("lines of equal values lie beside each other, each group in its colour", () => {
  const [first, second, third] = overlay([0, 0, 1].map((place, at) => ({ name: `${at}`, group: `${place}`, place, values: [1], x: [1] })));
  expect([first?.shift, second?.shift, third?.shift].map((shift) => Math.sign(shift ?? 0))).toEqual([-1, 0, 1]);
  expect([first?.colour === second?.colour, second?.colour === third?.colour]).toEqual([true, false]);
});

test("a search has a best score from its first complete set on, and ends with the set that was confirmed", () => {
  const now = { best: { objective: 6 }, cells: { simulated: 30, failed: 1 } } as Campaign;
  expect(courseOf(now, [])).toEqual([{ best: 6, mean: null, at: 31 }]);
  expect(courseOf(now, searches[0]?.generations ?? []).map(({ best, at }) => [best, at])).toEqual([[4, 10], [5, 14], [6, 31]]);
  expect(courseOf({ ...now, best: null }, [])).toEqual([]);
});

const scale = { name: "ease", unit: "1", direction: "maximise", lower: 0, upper: 10 };
const campaign = (objective: Record<string, unknown> | null, spec: Record<string, unknown> = {}): Campaign => ({ spec: { catalogue: "all", weights: {}, ...spec }, scale, objective }) as unknown as Campaign;
const [scored, cheap, quick] = [campaign(null), campaign({ name: "energy", unit: "kWh", direction: "minimise" }), campaign({ name: "time", unit: "s", direction: "minimise" })];

test("only like scores are compared", () => {
  expect([haveLikeScores([scored, cheap]), haveLikeScores([scored, { ...scored, scale: { ...scored.scale, direction: "minimise" } }])]).toEqual([true, false]);
  const pushed = ["first", "second"].map((evaluator) => ({ ...scored, setup: { evaluator, scenarios: [] } }) as unknown as Campaign);
  const changed = ["first", "second"].map((files) => ({ ...scored, setup: { evaluator: "one", scenarios: [{ scenario: "city", files }] } }) as unknown as Campaign);
  for (const unlike of [pushed, changed]) expect([haveLikeScores(unlike), byMeasure(unlike.map((of) => ({ of }))).length]).toEqual([false, 2]);
});

test("searches of unlike objectives share no axis, and keep their order", () => {
  const groups = byMeasure([scored, cheap, campaign(null), quick].map((of, place) => ({ of, place })));
  expect(groups.map(({ measure, searches }) => [measure.name, searches.map(({ place }) => place)])).toEqual([["ease", [0, 2]], ["energy", [1]], ["time", [3]]]);
});
