import { expect, test } from "vitest";
import { postCommands, pythonOf, tableCommands } from "./commands";

test("values are written as Python writes them", () => {
  expect(pythonOf({ a: null, b: [true, 1.5, "x\"y"], c: {} })).toBe('{"a": None, "b": [True, 1.5, "x\\"y"], "c": {}}');
});

test("a table can be had in three ways", () => {
  const shown = tableCommands("http://h:1", "0123456789abcdef", "evaluations");
  expect(shown.cli).toBe("drivecal export 01234567 --table evaluations --format csv -o evaluations.csv");
  expect(shown.curl).toBe("curl -s 'http://h:1/api/v1/campaigns/0123456789abcdef/evaluations?format=csv' -o evaluations.csv");
  expect(shown.python).toContain('with Client("http://h:1") as client:\n    table = client.frame("0123456789abcdef", "evaluations").to_pandas()');
  const weighted = tableCommands("", "0123456789", "solutions", { weights: "S1=2" });
  expect(weighted.python).toContain('client.frame("0123456789", "solutions", weights="S1=2")');
  expect(weighted.cli).toContain("--weights S1=2");
});

test("a quote in a body does not end the shell's word", () => {
  expect(postCommands("", "/campaigns", { name: "it's" }, "").curl).toContain(`'{"name":"it'\\''s"}'`);
});

test("Python submits with the call that fits", () => {
  expect(postCommands("", "/campaigns", { name: "x" }, "").python).toContain('client.submit({"name": "x"})');
  expect(postCommands("", "/comparisons", {}, "").python).toContain("client.compare({})");
  expect(postCommands("", "/campaigns/c1/rerun", { weights: { S1: 2 } }, "").python).toContain('client.rerun("c1", {"weights": {"S1": 2}})');
});
