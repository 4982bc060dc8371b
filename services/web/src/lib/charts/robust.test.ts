import { expect, test } from "vitest";
import { condition, pieces } from "./robust";
import type { BoxTrial, RobustnessRow } from "../server/types";

const trial = (radius: number, holds: boolean, deviations: Record<string, number | null>): BoxTrial => ({ box: Math.round(radius * 100), radius, holds, deviations });

test("a bar goes from box to box and says what each bears", () => {
  const row = { trials: [trial(0.2, true, { S1: 0, S2: 1 }), trial(0.1, true, { S1: 0, S2: 0 }), trial(0.3, false, { S1: 2, S2: null })] } as RobustnessRow;
  expect(pieces(row).map((piece) => [piece.from, piece.to, piece.worst, piece.looks])).toEqual([
    [0, 0.1, 0, "same"],
    [0.1, 0.2, 1, "changes"],
    [0.2, 0.3, null, "fails"],
  ]);
});

test("the condition is said in words", () => {
  expect(condition({ condition: "max", eta: 1 })).toBe("no score changes by more than 1");
  expect(condition({ condition: "per_factor", eta: 1 })).toBe("the relative change in every vehicle below 1");
  expect(condition({ condition: "mean", eta: [1, 2] })).toBe("the mean relative change over the vehicles below 1, 2");
});
