import { describe, expect, test } from "vitest";
import { brushText, brushes, parse, selecting, write } from "$lib/address";

describe("an address", () => {
  test("is read as it was written", () => {
    const place = { path: ["campaigns", "a/b c", "evaluations"], query: { "b.P1": "0:2.5", outcome: "reused,failed", note: "ä & #" } };
    expect(parse(write(place))).toEqual(place);
  });

  test("that is damaged is read as far as it goes", () => {
    expect(parse("#/campaigns/%E0%A4%A/x")).toEqual({ path: ["campaigns", "%E0%A4%A", "x"], query: {} });
  });

  test("holds ranges, open at either end", () => {
    expect(brushes({ "b.P1": "0:2.5", "b.P2": ":3", "b.score": "4:", "b.P3": "x:1", outcome: "1:2" })).toEqual({
      P1: [0, 2.5],
      P2: [-Infinity, 3],
      score: [4, Infinity],
    });
    expect(brushText([0.1 + 0.2, Infinity])).toBe("0.3:");
    expect(brushText([123457.32, 123457.326])).toBe("123457.32:123457.326");
  });

  test("tells a selection from all else: a chosen row, a chart and a parameter of their names select nothing anew", () => {
    const query = { "b.P 1": "0:2.5", "w.sort": "reused,a%2Cb", row: "7", chart: "scatter", sort: "-score" };
    const part = selecting(query);
    expect(selecting({ ...query, row: "8", sort: "score", lines: "1" })).toBe(part);
    expect(Object.fromEntries(new URLSearchParams(part))).toEqual({ "b.P 1": "0:2.5", "w.sort": "reused,a%2Cb" });
    expect(selecting({ ...query, "w.stage": "baseline" })).not.toBe(part);
  });

  test("holds every row at an end of a range: ends are rounded only outwards", () => {
    for (const [low, high] of [[0.12345678, 87.6543219], [-2 / 3, 2 / 3], [-87.6543219, -0.12345678], [1 / 3, 1234567.8]] as const) {
      const [from, to] = brushes({ "b.P1": brushText([low, high]) })["P1"] ?? [NaN, NaN];
      expect(from <= low && high <= to && to - from <= (high - low) * 1.001, `${low} to ${high}`).toBe(true);
    }
  });
});
