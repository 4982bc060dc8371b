import { expect, test, vi } from "vitest";

test("a set has the seeds of the runs that make its scores", async () => {
  vi.stubGlobal("location", { hash: "" });
  vi.stubGlobal("window", { addEventListener: () => undefined });
  const { sideOf } = await import("$lib/server/cells");
  const set = { rank: 1, iteration: 0, individual: 0, parameters: {}, scores: {}, reused: [], answers: {} };
  const rows = [{ ...set, seeds: [13, 14] }, { ...set, replicates: 3 }, { ...set, replicates: 1 }];
  expect(rows.map((row) => sideOf("id", row as unknown as Parameters<typeof sideOf>[1]).seeds)).toEqual([[13, 14], [1, 2, 3], []]);
});
