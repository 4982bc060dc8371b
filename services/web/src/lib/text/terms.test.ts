import { expect, test } from "vitest";
import glossary from "../../../../../docs/pages/concepts/glossary.md?raw";
import { anchorOf, explained, meaningOf, TERMS, type Word } from "./terms";

/** The glossary's entries by the anchors of their headings, without links and emphasis. */
const ENTRIES = new Map(
  glossary.split(/^## /m).slice(1).map((entry): [string, string] => {
    const [heading = "", ...lines] = entry.split("\n");
    return [heading.trim().toLowerCase().replaceAll(" ", "-"), lines.join(" ").replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").replaceAll("*", "").replaceAll(/ +/g, " ").trim()];
  }),
);

test.each(Object.entries(TERMS))("the page explains %s as the glossary does", (word, meaning) => {
  const entry = (ENTRIES.get(word) ?? "").replace(/ \([^)]*\)(?=[.:])/g, "");
  expect(entry.slice(0, meaning.length)).toBe(meaning);
});

test("an outcome is explained by its meaning, and found at the cells of the glossary", () => {
  expect(meaningOf("repeated")).toBe("Answered by the stored result of the same parameter set.");
  expect([anchorOf("repeated"), anchorOf("lot")]).toEqual(["cell", "lot"]);
});

test("each term of some texts is marked once, where it is met first", () => {
  const [first, second] = explained(["A sample of each of 3 lots was simulated", "a sample of each lot, 2 lots, audited, `audit`"]);
  expect(first).toEqual([{ text: "A sample of each of 3 " }, { text: "lots", word: "lot" }, { text: " was simulated" }]);
  expect(second?.filter((piece) => piece.word).map((piece): [string, Word | undefined] => [piece.text, piece.word])).toEqual([["sample", "sample"], ["audited", "audit"]]);
  expect(second?.map((piece) => piece.text).join("")).toBe("a sample of each lot, 2 lots, audited, `audit`");
  expect(explained(["`drivecal lot`", "none"])).toEqual([[{ text: "`drivecal lot`" }], [{ text: "none" }]]);
});
