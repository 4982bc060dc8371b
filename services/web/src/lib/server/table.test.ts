import { afterEach, expect, test, vi } from "vitest";
import { cell } from "./columns";
import { TableState } from "./table.svelte";

afterEach(() => void vi.unstubAllGlobals());

const CSV = "id,scenario,gear,parameter_score,P1,score\n1,S1,1,2.0,1,7\n2,S1,5,4.0,2,3\n";
const CHOICES = [{ name: "gear", choices: ["1", "2", "5"] }, { name: "score", choices: ["2.0", "4.0"] }, { name: "P1" }].map((parameter) => ({ unit: "1", lower: 0, upper: 2, ...parameter }));

test("parameters with choices hold words, whatever they look like, and columns of the table stay numbers", async () => {
  vi.stubGlobal("fetch", async () => new Response(CSV));
  const rows = new TableState("EvaluationRow", () => CHOICES);
  await rows.load("/evaluations");
  expect(["gear", "parameter_score", "P1", "score"].map((name) => cell(rows.table, name, 1))).toEqual(["5", "4.0", 2, 3]);
});
