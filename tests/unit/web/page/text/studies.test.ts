import { expect, test } from "vitest";
import { possibleStudies, studySpecification } from "$lib/text/studies";
import type { Campaign } from "$lib/server/types";

const ENDED = { id: "abc", name: "mine (robustness)", kind: "calibration", spec: { optimizer: { kind: "genetic" }, vehicle: { model: "hybrid" }, validation: {} }, links: {}, best: {}, ended_at: "2026-01-01", cells: { predicted: 0 } } as unknown as Campaign;
const MAPPED = { ...ENDED, links: { influence_map: "/api/v1/influence-maps/m1" } } as unknown as Campaign;

/** A problem without a vehicle model whose runs have a side condition. */
const VARIED = { scenarios: [{ scenario: "S1", vehicle: null, vehicle_parameters: { mass: 1500 } }] };

test("studies are offered of an ended search with a result, if there is something to examine", () => {
  expect(possibleStudies(ENDED, VARIED)).toEqual(["robustness"]);
  expect(possibleStudies(ENDED, { scenarios: [{ scenario: "S1@east", vehicle_parameters: { mass: 1500 } }] })).toEqual([]); // variants have vehicles of their own
  expect(possibleStudies(MAPPED, null)).toEqual(["map"]);
  expect(possibleStudies({ ...ENDED, cells: { ...ENDED.cells, predicted: 3 } }, null)).toEqual(["predictions"]);
  expect(possibleStudies({ ...MAPPED, cells: { ...ENDED.cells, predicted: 3 } }, VARIED)).toEqual(["robustness", "map", "predictions"]);
  expect(possibleStudies({ ...MAPPED, ended_at: null }, VARIED)).toEqual([]);
  expect(possibleStudies({ ...MAPPED, best: null }, VARIED)).toEqual([]);
});

test("a study is a campaign without a search, on the bench of its subject", () => {
  expect(studySpecification(ENDED, "robustness")).toEqual({ vehicle: { model: "hybrid" }, optimizer: null, sensitivity: null, robustness: { of: "abc" }, validation: null, name: "mine (robustness)" });
  expect(studySpecification(MAPPED, "map")).toMatchObject({ sensitivity: { map: "m1" }, validation: {}, robustness: null });
  expect(studySpecification(MAPPED, "predictions")).toMatchObject({ sensitivity: null, validation: { of: "abc" } });
});
