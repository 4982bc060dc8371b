import { expect, test } from "vitest";
import { largest, piece, segment } from "./spider";
import type { InfluenceRow } from "../server/types";

const ROW: InfluenceRow = {
  scenario: "S1", parameter: "P1", influential: true, lower: -9, upper: 14, s_rel_intervals: [0, null, 0.5], mu: null, sigma: null, mu_star: null, unknown: false, n_values: 9,
  unit: "dB", space_lower: -15, space_upper: 15, decided_by: null, reason: null,
};

test("the influential part is told in shares of the range", () => {
  expect(segment(ROW)).toEqual([0.2, 29 / 30]);
  expect(segment({ ...ROW, influential: false })).toBeNull();
  expect(segment({ ...ROW, lower: null, upper: null })).toEqual([0, 1]);
  expect(segment({ ...ROW, space_lower: null })).toEqual([0, 1]);
});

test("all scenarios have one scale", () => {
  expect(largest([ROW, { ...ROW, s_rel_intervals: [2] }, { ...ROW, s_rel_intervals: null }])).toBe(2);
});

test("a spoke begins at the hub and ends at the rim", () => {
  expect(piece(0, 1, 0, 1, 100).startsWith("M0.00 -20.00A20.00")).toBe(true);
  expect(piece(0, 1, 0, 1, 100)).toContain("A100.00 100.00 0 0 0 0.00 -100.00Z");
});
