import { expect, test } from "vitest";
import { Broken, at, brokenIn } from "./problems";
import { written, writtenList } from "../forms/schema";

const PROBLEMS = [
  { field: "optimizer.population", message: "-3 is too small", remedy: "give at least 2" },
  { field: "weights.S9", message: "there is no scenario S9", remedy: "" },
  { field: "parameters[0].lower", message: "the value is missing", remedy: "give it" },
];

test("each field says what is wrong with it and what would be right", () => {
  expect(at(PROBLEMS, "optimizer.population")).toEqual(["-3 is too small; give at least 2"]);
  expect(at(PROBLEMS, "optimizer", true)).toEqual([]);
  expect(at(PROBLEMS, "weights")).toEqual(["S9: there is no scenario S9"]);
  expect(at(PROBLEMS, "parameters")).toEqual(["1, lower: the value is missing; give it"]);
  expect(at(PROBLEMS, "weight")).toEqual([]);
});

test("half of a JSON document is neither a word nor a list of words", () => {
  const wanted = { parameters: written('[{"name":"P1"'), seeds: writtenList("[1, 2"), optimizers: [{ kind: "genetic" }, { mutation: written("{") }] };
  expect(wanted.parameters).toBeInstanceOf(Broken);
  expect(brokenIn(wanted).map((entry) => entry.field)).toEqual(["parameters", "seeds", "optimizers[1].mutation"]);
  expect(brokenIn({ name: written("a [strange] name"), none: null })).toEqual([]);
  expect(JSON.stringify({ seeds: wanted.seeds })).toBe('{"seeds":"[1, 2"}');
});
