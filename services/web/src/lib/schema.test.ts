import { expect, test } from "vitest";
import { changed, describe, differences, written, type Definitions } from "./schema";

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
});

test("objects are found behind references and choices, and whether they may be left out", () => {
  const found = describe({ anyOf: [{ oneOf: [{ $ref: "#/components/schemas/Search" }, { $ref: "#/components/schemas/Map" }] }, { type: "null" }], default: { seed: 3 } }, DEFINITIONS);
  expect([found.kind, found.optional, Object.keys(found.schema.properties ?? {}), found.schema.default]).toEqual(["object", true, ["kind", "seed"], { seed: 3 }]);
  expect(describe({ $ref: "#/components/schemas/Search" }, DEFINITIONS).optional).toBe(false);
});

test("what is written is JSON where it can be", () => {
  expect([written("highway"), written('["S1"]'), written("0.5"), written(" ")]).toEqual(["highway", ["S1"], 0.5, undefined]);
});

test("a change leaves the rest, and taking it back leaves nothing", () => {
  const document = changed({ a: 1 }, "b", null);
  expect(document).toEqual({ a: 1, b: null });
  expect(changed(document, "b", undefined)).toEqual({ a: 1 });
});

test("two documents are compared leaf by leaf", () => {
  expect(differences({ a: { b: 1, c: [1, 2] }, d: "x" }, { a: { b: 2, c: [1, 2] }, e: null })).toEqual([
    { path: "a.b", one: "1", other: "2" },
    { path: "d", one: "x", other: null },
    { path: "e", one: null, other: "null" },
  ]);
});
