import { expect, test, vi } from "vitest";

test("a set has the seeds of the runs that make its scores", async () => {
  for (const [name, value] of Object.entries({ location: { hash: "" }, window: { addEventListener: () => undefined } })) vi.stubGlobal(name, value);
  const { baselineSide, sideOf } = await import("$lib/server/cells");
  type Given = Parameters<typeof baselineSide>;
  const [campaign, front] = [{ id: "id", best: null, baseline: { parameters: {}, scores: {} } }, { baseline: { objectives: { time: 2 }, values: { "time@S1": 2 } } }] as unknown as [Given[0], Given[2]];
  expect([baselineSide(campaign, false, front)?.goals, baselineSide(campaign, false)?.goals]).toMatchObject([{ values: { "time@S1": 2 } }, undefined]);
  const rows = [{ seeds: [13, 14], reused: [] }, { seeds: [1, 3], answers: {} }, { seeds: [], answers: {} }] as unknown[];
  expect(rows.map((row) => sideOf("id", row as Parameters<typeof sideOf>[1]).seeds)).toEqual([[13, 14], [1, 3], []]);
});

test("two sets are replayed under seeds of both", async () => {
  const { sharedSeeds } = await import("$lib/server/cells");
  const cell = (...seeds: number[]) => ({ evaluation: 1, runs: seeds.map((seed): [number, number] => [seed, 10 * seed]) });
  expect([[cell(13, 14, 1)], [cell(13, 14, 1), cell(1, 14)], [cell(13), cell(1)], [cell()], []].map(sharedSeeds)).toEqual([[13, 14, 1], [14, 1], [], [], []]);
});
