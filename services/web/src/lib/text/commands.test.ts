import { expect, test } from "vitest";
import { postCommands, pythonOf, tableCommands } from "./commands";

test("values are written as Python writes them", () => {
  expect(pythonOf({ a: null, b: [true, 1.5, "x\"y"], c: {} })).toBe('{"a": None, "b": [True, 1.5, "x\\"y"], "c": {}}');
});

test("a table can be had in three ways", () => {
  const found = tableCommands("http://h:1", "0123456789abcdef", "evaluations");
  expect(found.cli).toBe("drivecal export 01234567 --table evaluations --format csv -o evaluations.csv");
  expect(found.curl).toBe("curl -s 'http://h:1/api/v1/campaigns/0123456789abcdef/evaluations?format=csv' -o evaluations.csv");
  expect(tableCommands("", "0123456789", "solutions", { weights: "S1=2" }).cli).toContain("--weights S1=2");
});

test("a quote in a body does not end the shell's word", () => {
  expect(postCommands("", "/campaigns", { name: "it's" }, "").curl).toContain(`'{"name":"it'\\''s"}'`);
});
