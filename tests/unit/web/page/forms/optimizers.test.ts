import { expect, test } from "vitest";
import type { Shape } from "$lib/server/shape";
import type { OptimizerAnswer } from "$lib/server/types";
import { comparedOf, sectionOf, suiting, withSettings } from "$lib/forms/optimizers";
import { describe } from "$lib/forms/schema";

const OPTIMIZERS: OptimizerAnswer[] = [
  { name: "genetic", supports: ["choice", "constraints", "continuous", "grid", "integer"], settings: { properties: { kind: { const: "genetic" }, population: { type: "integer" }, mutation: { type: "number", maximum: 1 } } } },
  { name: "swarm", supports: ["grid", "integer"], settings: { properties: { kind: { const: "swarm" }, population: { type: "integer" }, inertia: { type: "number" } } } },
];
const MIXED = {
  constraints: ["a <= b"],
  parameters: [{ name: "a", kind: "choice", unit: "1", description: "", lower: 0, upper: 1, step: null, choices: ["x", "y"] }],
} as Partial<Shape> as Shape;

test("only optimizers that can search the problem are offered", () => {
  expect(suiting(OPTIMIZERS, MIXED)).toEqual(["genetic"]);
  expect(suiting(OPTIMIZERS, { ...MIXED, parameters: [], constraints: [] })).toEqual(["genetic", "swarm"]);
});

test("an optimizer's own settings are fields", () => {
  const section = describe(sectionOf({ default: { kind: "genetic" } }, OPTIMIZERS, { kind: "swarm" }), {});
  expect([section.kind, section.optional, Object.keys(section.schema.properties ?? {})]).toEqual(["object", true, ["kind", "population", "inertia", "start_sets", "start_results"]]);
  expect(describe(section.schema.properties?.["kind"] ?? {}, {}).kind).toBe("text");
  expect(sectionOf({ type: "object" }, OPTIMIZERS, { kind: "of a plug-in" })).toEqual({ type: "object" });
});

test("each compared optimizer has its own settings, without those of the comparison", () => {
  const item = { properties: { kind: { type: "string" } }, additionalProperties: true };
  const list = comparedOf({ type: "array", items: { $ref: "#/Compared" } }, OPTIMIZERS, [{ kind: "swarm" }, { kind: "of a plug-in" }], { Compared: item });
  expect(list.prefixItems?.map((entry) => Object.keys(entry.properties ?? {}))).toEqual([["kind", "inertia"], ["kind"]]);
  expect(list.prefixItems?.map((entry) => entry.additionalProperties)).toEqual([false, true]);
});

test("settings of another optimizer do not stay", () => {
  const before = { kind: "genetic", population: 20, mutation: 0.2 };
  expect(withSettings(OPTIMIZERS, before, { ...before, kind: "swarm", start_sets: [{}], start_results: "car" })).toEqual({ kind: "swarm", population: 20, start_sets: [{}], start_results: "car" });
  expect(withSettings(OPTIMIZERS, before, { ...before, mutation: 0.5 })).toEqual({ ...before, mutation: 0.5 });
  expect(withSettings(OPTIMIZERS, before, null)).toBeNull();
});
