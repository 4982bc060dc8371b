import { expect, test } from "vitest";
import { columnsOf } from "./document";

test("a column is what the schema of the rows says, whatever its name", () => {
  const optional = (type: string) => ({ anyOf: [{ type }, { type: "null" }] });
  const columns = columnsOf({ properties: { lot: optional("integer"), confidence: optional("number"), proof_agrees: optional("boolean"), worker: { type: "string" } } });
  expect([...columns]).toEqual([["lot", true], ["confidence", true], ["proof_agrees", false], ["worker", false]]);
});
