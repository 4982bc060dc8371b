import { describe, expect, test } from "vitest";
import { CsvReader, cell, csvOf, extent, type Table } from "$lib/server/columns";
import { ordered, select } from "$lib/server/select";

const TEXT = new Set(["scenario", "failure"]);
const CSV = `id,scenario,P1,score,failure\n1,S1,0.5,7,\n2,S2,-1.5,,collision\n3,S10,2,0,"off, ""far"" off\nthe road"\n4,S2,2,3,\n`;

function read(pieces: string[]): Table {
  const reader = new CsvReader(TEXT);
  for (const piece of pieces) reader.push(piece);
  return reader.finish();
}

describe("a table", () => {
  test("is the same however it is cut to pieces", () => {
    const whole = read([CSV]);
    for (const size of [1, 2, 7, 30]) {
      const pieces = Array.from({ length: Math.ceil(CSV.length / size) }, (_, at) => CSV.slice(at * size, (at + 1) * size));
      expect(read(pieces)).toEqual(whole);
    }
    expect(read([CSV.trimEnd()])).toEqual(whole);
    expect(read([CSV.replaceAll("\n", "\r\n")]).length).toBe(4);
  });

  test("keeps numbers, words and what is missing", () => {
    const table = read([CSV]);
    expect(table.names).toEqual(["id", "scenario", "P1", "score", "failure"]);
    expect([cell(table, "score", 0), cell(table, "score", 1), cell(table, "score", 2)]).toEqual([7, null, 0]);
    expect([cell(table, "failure", 0), cell(table, "failure", 1), cell(table, "failure", 2)]).toEqual([null, "collision", 'off, "far" off\nthe road']);
    expect(extent(table, "P1")).toEqual([-1.5, 2]);
    expect(extent(table, "failure")).toBeNull();
  });

  test("has choices as words, also where the first ones look like numbers", () => {
    const table = read(["mode,P1\n,1\n2,2\n", "eco,\n2,3\n"]);
    expect([0, 1, 2, 3].map((row) => cell(table, "mode", row))).toEqual([null, "2", "eco", "2"]);
    expect([0, 1, 2, 3].map((row) => cell(table, "P1", row))).toEqual([1, 2, null, 3]);
    expect(extent(table, "mode")).toBeNull();
  });
});

describe("a selection", () => {
  const table = read([CSV]);

  test("is what has the words and lies in the ranges", () => {
    expect([...select(table, { words: {}, ranges: {} })]).toEqual([0, 1, 2, 3]);
    expect([...select(table, { words: { scenario: ["S2"] }, ranges: {} })]).toEqual([1, 3]);
    expect([...select(table, { words: { scenario: ["S2"] }, ranges: { score: [-Infinity, Infinity] } })]).toEqual([3]);
    expect([...select(table, { words: { scenario: [] }, ranges: { P1: [0.5, 2], nothing: [0, 1] } })]).toEqual([0, 2, 3]);
  });

  test("is ordered, what is missing comes last either way", () => {
    const all = select(table, { words: {}, ranges: {} });
    expect([...ordered(table, all, "score", false)]).toEqual([2, 3, 0, 1]);
    expect([...ordered(table, all, "score", true)]).toEqual([0, 3, 2, 1]);
    expect([...ordered(table, all, "scenario", false)]).toEqual([0, 1, 3, 2]);
    expect([...ordered(table, all, "P1", true)]).toEqual([2, 3, 0, 1]);
  });
});

test("a drawing's file holds no formula for any separator, and numbers stay numbers", () => {
  const texts = ["=1", "a;=1", "a\t@x", 'a;"=1"', "plain", "a;-1"];
  const file = csvOf({ head: ["name", "value"], rows: texts.map((text) => [text, -1.5]) });
  expect(file).toBe("name,value\n'=1,-1.5\n\"a;'=1\",-1.5\n\"a\t'@x\",-1.5\n\"a;'\"\"=1\"\"\",-1.5\nplain,-1.5\n\"a;-1\",-1.5\n");
  const reader = new CsvReader(new Set(["name"]));
  reader.push(file);
  const table = reader.finish();
  expect(texts.map((_, row) => cell(table, "name", row))).toEqual(texts);
});
