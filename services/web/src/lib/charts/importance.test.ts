import { expect, test } from "vitest";
import { bars, judgement } from "./importance";

test("bars are ordered and in shares of the longest; chance below 0 has no length", () => {
  const ordered = bars([{ name: "a", value: -0.1, deviation: 0 }, { name: "b", value: 0.5, deviation: 0.1 }, { name: "c", value: 0.25, deviation: 0 }]);
  expect(ordered.map((bar) => [bar.name, bar.share])).toEqual([["b", 1], ["c", 0.5], ["a", 0]]);
  expect(bars([{ name: "a", value: 0, deviation: 0 }])[0]?.share).toBe(0);
});

test("a forest that explains little is called so, and one without sets has no importance", () => {
  const item = { parameter: "a", importance: 1, deviation: 0 };
  expect(judgement({ items: [item], sets: 100, held_out: 33, r2: 0.9 })).not.toContain("little");
  expect(judgement({ items: [item], sets: 100, held_out: 33, r2: 0.1 })).toContain("little");
  expect(judgement({ items: [], sets: 12, held_out: null, r2: null })).toContain("12 sets");
});
