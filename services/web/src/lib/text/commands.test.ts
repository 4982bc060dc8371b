import { expect, test, vi } from "vitest";
import { calibrationFile, copied, postCommands, pythonOf, tableCommands, tradeOffCommands } from "./commands";

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
  expect(weighted.cli).toBe("drivecal export 01234567 --table solutions --format csv --weights S1=2 -o solutions.csv");
});

test("what is selected is selected in every way", () => {
  const shown = tableCommands("http://h:1", "0123456789abcdef", "evaluations", {}, ["outcome=reused", "P1>=0.5", "mode=it's"]);
  expect(shown.cli).toContain(`--where outcome=reused --where "P1>=0.5" --where "mode=it's"`);
  expect(shown.python).toContain('client.frame("0123456789abcdef", "evaluations", where=["outcome=reused", "P1>=0.5", "mode=it\'s"])');
  expect(shown.curl).toContain("evaluations?where=outcome%3Dreused&where=P1%3E%3D0.5&where=mode%3Dit%27s&format=csv'");
});

test("a word is quoted so that the shells of Windows read it as well, unless a shell would read in it", () => {
  const cli = (condition: string): string => tableCommands("", "0123456789abcdef", "evaluations", {}, [condition]).cli;
  expect(cli("mode=50 %")).toContain("--where 'mode=50 %' ");
  expect(cli("mode=$it's")).toContain(`--where 'mode=$it'\\''s' `);
  expect(cli('mode="a b"')).toContain(`--where 'mode="a b"' `);
});

test("a browser without a clipboard copies nothing and says so", async () => {
  vi.stubGlobal("navigator", {});
  expect(await copied("text")).toBe(false);
  const writeText = vi.fn(async () => undefined);
  vi.stubGlobal("navigator", { clipboard: { writeText } });
  expect([await copied("text"), writeText.mock.calls]).toEqual([true, [["text"]]]);
  vi.unstubAllGlobals();
});

test("a quote in a body does not end the shell's word", () => {
  expect(postCommands("", "/campaigns", { name: "it's" }, "").curl).toContain(`'{"name":"it'\\''s"}'`);
});

test("Python submits with the call that fits", () => {
  expect(postCommands("", "/campaigns", { name: "x" }, "").python).toContain('client.submit({"name": "x"})');
  expect(postCommands("", "/comparisons", {}, "").python).toContain("client.compare({})");
  expect(postCommands("", "/campaigns/c1/rerun", { weights: { S1: 2 } }, "").python).toContain('client.rerun("c1", {"weights": {"S1": 2}})');
});

test("a front of everything that is stored is a flag of the command line and a truth in Python", () => {
  const { cli, python, curl } = tradeOffCommands("http://host", "0123456789abcdef", 3, 12, { everything: "true" });
  expect(cli).toBe("drivecal front 01234567 --between 3,12 --everything");
  expect(python).toContain('client.trade_off("0123456789abcdef", 3, 12, everything=True)');
  expect(curl).toBe("curl -s 'http://host/api/v1/campaigns/0123456789abcdef/front/trade-off?first=3&second=12&everything=true'");
  expect(calibrationFile("0123456789abcdef", "dcm", { front: "12", weights: "a=1,b=2" })).toBe("/api/v1/campaigns/0123456789abcdef/calibration-file?front=12&weights=a%3D1%2Cb%3D2&format=dcm");
});
