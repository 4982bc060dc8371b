import { expect, test, vi } from "vitest";

test("a chosen set keeps its place in the address when other sets are ranked before it", async () => {
  for (const [name, value] of Object.entries({ location: { hash: "" }, window: { addEventListener: () => undefined } })) vi.stubGlobal(name, value);
  const { followed } = await import("$lib/followed.svelte");
  const of = (...sets: string[]) => ({ setOf: (rank: string) => sets[Number(rank) - 1] ?? null, rankOf: (set: string) => (sets.includes(set) ? String(sets.indexOf(set) + 1) : null) });
  const first = followed(["2", "baseline", "1"], [], of("a", "b"));
  expect(first.ranks).toEqual(["2", "baseline", "1"]);
  const next = followed(first.ranks, first.chosen, of("new", "a", "b"));
  expect(next.ranks).toEqual(["3", "baseline", "2"]);
  expect(followed(["1", "2"], next.chosen, of("newer", "new", "a", "b")).ranks, "another rank names a set of this table").toEqual(["1", "3"]);
  expect(followed(["3"], next.chosen, of("a")).ranks, "a table that is read in part").toEqual(["3"]);
});
