import { expect, test } from "vitest";
import { calibrates, kindOf, possibleStudies, settingsText, studiesOf, studySettings, studySpecification } from "./studies";
import type { Campaign } from "../server/types";

const ROBUSTNESS = { delta: 0.01, steps: 10, samples: 30, eta: 1, condition: "max", of: "abc" };

test("a campaign without an optimizer is told by its studies", () => {
  const study = { kind: "calibration", spec: { optimizer: null, robustness: ROBUSTNESS, validation: null } };
  expect([calibrates(study), studiesOf(study), kindOf(study)]).toEqual([false, ["robustness"], "robustness study"]);
  const both = { kind: "calibration", spec: { optimizer: { kind: "genetic" }, validation: {} } };
  expect([calibrates(both), studiesOf(both), kindOf(both)]).toEqual([true, ["validation"], ""]);
  expect(calibrates({ kind: "calibration", spec: {} })).toBe(true);
});

test("a study says how it is made", () => {
  expect(settingsText("robustness", ROBUSTNESS)).toBe("up to 10 boxes, each wider by 0.01, with 30 simulated vehicles in each; condition: no score changes by more than 1; up to 9.5 % of all vehicles in a box that holds may still break it (95 % confidence)");
  expect(settingsText("validation", { samples: 200, references: 30, largest: 20_000 })).toContain("30 variants of each set");
  expect(settingsText("validation", { samples: 500, references: 30, largest: 20_000, of: "a" })).toMatch(/500 released predictions/);
});

const ENDED = { id: "abc", name: "mine (robustness)", kind: "calibration", spec: { optimizer: { kind: "genetic" }, vehicle: { model: "hybrid" }, validation: {} }, links: {}, best: {}, ended_at: "2026-01-01", cells: { predicted: 0 } } as unknown as Campaign;
const MAPPED = { ...ENDED, links: { influence_map: "/api/v1/influence-maps/m1" } } as unknown as Campaign;

test("studies are offered of an ended search with a result, if there is something to examine", () => {
  expect(possibleStudies(ENDED, true)).toEqual(["robustness"]);
  expect(possibleStudies(MAPPED, false)).toEqual(["validation"]);
  expect(possibleStudies({ ...ENDED, cells: { ...ENDED.cells, predicted: 3 } }, false)).toEqual(["validation"]);
  expect(possibleStudies({ ...MAPPED, ended_at: null }, true)).toEqual([]);
  expect(possibleStudies({ ...MAPPED, best: null }, true)).toEqual([]);
});

test("a study is a campaign without a search, on the bench of its subject", () => {
  expect(studySpecification(ENDED, "robustness")).toEqual({ vehicle: { model: "hybrid" }, optimizer: null, sensitivity: null, robustness: { of: "abc" }, validation: null, name: "mine (robustness)" });
  expect(studySpecification(MAPPED, "validation")).toMatchObject({ sensitivity: { map: "m1" }, validation: {}, robustness: null });
  expect(studySpecification(ENDED, "validation")).toMatchObject({ sensitivity: null, validation: { of: "abc" } });
});

test("settings of a study go into its specification, whatever it examines", () => {
  expect(studySpecification(ENDED, "robustness", { delta: 0.02, of: "other" })["robustness"]).toEqual({ delta: 0.02, of: "abc" });
  expect(studySpecification(MAPPED, "validation", { samples: 50 })["validation"]).toEqual({ samples: 50 });
  expect(studySpecification(ENDED, "validation", { samples: 50 })["validation"]).toEqual({ of: "abc", samples: 50 });
});

test("predictions are validated by a number of samples alone, a map by its variants too", () => {
  expect(studySettings(ENDED, "validation").names).toEqual(["samples", "seed"]);
  expect(studySettings(MAPPED, "validation").names).toContain("references");
  expect(studySettings(MAPPED, "robustness").names).not.toContain("of");
});
