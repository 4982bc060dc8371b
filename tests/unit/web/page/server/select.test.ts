import { describe, expect, test } from "vitest";
import type { Table } from "$lib/server/columns";
import { drawn, numbered, ordered, recycled, select, within } from "$lib/server/select";

/** Values that look random, many of them equal, every ninth missing. */
function values(length: number, distinct: number): Float64Array {
  return Float64Array.from({ length }, (_, row) => (row % 9 === 4 ? Number.NaN : (row * 7919) % distinct));
}

function table(length: number, distinct: number): Table {
  return {
    length,
    names: ["score", "stage"],
    columns: {
      score: { kind: "number", name: "score", values: values(length, distinct) },
      stage: { kind: "text", name: "stage", codes: new Int32Array(length).map((_, row) => (row % 5 === 0 ? 1 : row % 11 === 0 ? -1 : 0)), words: ["calibration", "validation"] },
    },
  };
}

describe("of many rows", () => {
  test("the best share of the search is drawn, of equal ones the first, in the order of the rows", () => {
    for (const distinct of [7, 1009]) {
      const rows = table(1000, distinct);
      const score = values(1000, distinct);
      for (const [sign, share] of [[1, 0.05], [-1, 0.25], [1, 0.01]] as const) {
        const search = [...numbered(1000)].filter((row) => row % 5 !== 0 && row % 11 !== 0 && row % 9 !== 4);
        const most = Math.max(20, Math.ceil(share * search.length));
        const worth = (row: number): number => sign * (score[row] as number);
        const best = search.slice().sort((row, other) => worth(other) - worth(row) || row - other).slice(0, most).sort((row, other) => row - other);
        expect([...drawn(rows, numbered(1000), { by: "score", sign, share, least: 20 })]).toEqual(best);
      }
    }
  });

  test("a selection in the order of all rows is the ordered selection", () => {
    const rows = table(500, 17);
    const selected = select(rows, { words: { stage: ["calibration"] }, ranges: { score: [3, 9] } });
    expect(selected.length).toBeGreaterThan(100);
    for (const [name, descending] of [["score", false], ["score", true], ["stage", true], ["nothing", false]] as const) {
      expect([...within(ordered(rows, numbered(500), name, descending), selected)]).toEqual([...ordered(rows, selected, name, descending)]);
    }
  });

  test("all in sight have a line, and keep it while they are in sight", () => {
    for (const lines of [1, 2, 7, 36]) {
      for (let first = 0; first < 3 * lines; first++) {
        const places = recycled(first, lines);
        expect(places.slice().sort((place, other) => place - other)).toEqual(Array.from({ length: lines }, (_, line) => first + line));
        const next = recycled(first + 1, lines);
        expect(places.filter((place, line) => next[line] !== place)).toEqual([first]);
      }
    }
    expect(recycled(0, 3)).toEqual([0, 1, 2]);
    expect(recycled(0, 0)).toEqual([]);
  });
});
