import { expect, test } from "vitest";
import { Broken } from "$lib/forms/faults";
import { describe, fieldsOf, listText, others, pairsText, writtenList, writtenPairs, type Definitions } from "$lib/forms/schema";

const DEFINITIONS: Definitions = {
  Search: { type: "object", properties: { kind: { enum: ["genetic", "random"] }, seed: { type: "integer", default: 1 } } },
  Map: { type: "object", properties: { map: { type: "string" } } },
};

test("a schema says what field it wants", () => {
  const kind = (schema: object): string => describe(schema, DEFINITIONS).kind;
  expect(kind({ enum: ["a", "b"] })).toBe("choice");
  expect(kind({ type: "boolean" })).toBe("truth");
  expect(kind({ type: "integer" })).toBe("whole");
  expect(kind({ anyOf: [{ type: "number" }, { type: "null" }] })).toBe("number");
  expect(kind({ type: "string" })).toBe("text");
  expect(kind({ anyOf: [{ type: "string" }, { type: "array" }] })).toBe("json");
  expect(kind({ type: "object", patternProperties: {} })).toBe("json");
  expect(kind({ type: "array", items: { type: "integer" } })).toBe("list");
  expect(kind({ type: "array", items: { $ref: "#/components/schemas/Search" } })).toBe("objects");
  expect(kind({ type: "array", items: { type: "object", patternProperties: {} } })).toBe("json");
});

test("a word or a number may stand for a list, and an object for a choice", () => {
  const of = (...anyOf: object[]) => describe({ anyOf }, { Quantile: { properties: { quantile: { type: "number" } } } });
  const names = { type: "array", items: { type: "string" } };
  expect(of({ type: "string", const: "all" }, names)).toMatchObject({ kind: "list", choices: ["all"], single: false });
  expect(of({ type: "number" }, { type: "array", items: { type: "number" } })).toMatchObject({ kind: "list", choices: [], single: true });
  expect(of({ type: "string" }, names).kind).toBe("json");
  const choice = of({ type: "string", enum: ["mean", "min"] }, { $ref: "#/components/schemas/Quantile" }, { type: "null" });
  expect([choice.kind, choice.choices, choice.optional, Object.keys(choice.instead?.properties ?? {})]).toEqual(["choice", ["mean", "min"], true, ["quantile"]]);
  expect(of({ type: "number" }, { type: "string", const: "auto" }, { $ref: "#/components/schemas/Quantile" }).kind).toBe("json");
  const all = { choices: ["all"], single: true };
  expect([writtenList("all", all), writtenList("S1", all), writtenList("S1, all", all), writtenList("2", all), writtenList("2, 3", all)]).toEqual(["all", ["S1"], ["S1", "all"], 2, [2, 3]]);
  expect([listText("all"), listText(2)]).toEqual(["all", "2"]);
});

test("numbers by name are written as on the command line, or as JSON", () => {
  expect(describe({ type: "object", patternProperties: { "^S": { type: "number" } } }, {}).kind).toBe("pairs");
  expect([writtenPairs("S1=2, S2 = 0.5\nS3=0"), writtenPairs('{"S1": 2}'), writtenPairs(" ")]).toEqual([{ S1: 2, S2: 0.5, S3: 0 }, { S1: 2 }, undefined]);
  for (const text of ["S1", "S1=", "=2", "S1=two", "S1=1=2", "S1=1e999", "S1=2, S1=3", '{"S1"']) expect(writtenPairs(text)).toBeInstanceOf(Broken);
  expect([pairsText({ S1: 2, S2: 0.5 }), pairsText(undefined), pairsText(writtenPairs("S1="))]).toEqual(["S1=2, S2=0.5", "", "S1="]);
});

test("objects are described behind references and choices, and whether they may be left out", () => {
  const described = describe({ anyOf: [{ oneOf: [{ $ref: "#/components/schemas/Search" }, { $ref: "#/components/schemas/Map" }] }, { type: "null" }], default: { seed: 3 } }, DEFINITIONS);
  expect([described.kind, described.optional, Object.keys(described.schema.properties ?? {}), described.schema.default]).toEqual(["object", true, ["kind", "seed"], { seed: 3 }]);
  expect(describe({ $ref: "#/components/schemas/Search" }, DEFINITIONS).optional).toBe(false);
});

test("two documents are compared leaf by leaf", () => {
  expect(fieldsOf({ a: { b: 1, c: [1, 2] }, d: "x", w: {} }, { a: { b: 2, c: [1, 2] }, e: null })).toEqual([
    { path: "a.b", values: ["1", "2"] },
    { path: "a.c", values: ["1, 2", "1, 2"] },
    { path: "d", values: ["x", null] },
    { path: "e", values: [null, "null"] },
  ]);
  expect(fieldsOf({ a: 1 }, { a: 1 }, { a: 2 })).toEqual([{ path: "a", values: ["1", "1", "2"] }]);
  const goals = [{ score: "comfort", measure: null, weights: {}, failed: null }, { score: "safety", at_most: 2 }];
  expect(fieldsOf({ goals, on: true, sets: [] }, { goals: ["a", "b"], on: false, sets: [1] })).toEqual([
    { path: "goals", values: ["score comfort; score safety, at most 2", "a, b"] },
    { path: "on", values: ["yes", "no"] },
    { path: "sets", values: ["none", "1"] },
  ]);
});

test("lists are written with commas, and as JSON where they hold more than words and numbers", () => {
  expect([writtenList("100, 200"), writtenList("off, exact"), writtenList(" "), writtenList('[{"mode": "off"}]')]).toEqual([[100, 200], ["off", "exact"], undefined, [{ mode: "off" }]]);
  expect([listText([1, 2]), listText([{ mode: "off" }]), listText(undefined)]).toEqual(["1, 2", '[{"mode":"off"}]', ""]);
});

test("what a plug-in takes besides is told apart from what the schema names", () => {
  expect(others({ kind: "genetic", mutation: 0.2 }, DEFINITIONS["Search"] ?? {})).toEqual({ mutation: 0.2 });
});
