import { afterEach, expect, test, vi } from "vitest";
import { Run } from "$lib/server/run.svelte";

afterEach(() => void vi.unstubAllGlobals());

test("a run without its answer is read again, and traced when it has one", async () => {
  let outcome: string | null = null;
  const asked: string[] = [];
  vi.stubGlobal("fetch", (address: string) => {
    asked.push(address.slice(address.lastIndexOf("/") + 1));
    const problem = { series: { t: "s" }, scenarios: {}, simulator: { kind: "command" } };
    const answer = address.includes("/problems/") ? problem : address.endsWith("/trace") ? { series: { t: [0, 1] } } : { outcome, campaign: { problem: "p" } };
    return Promise.resolve(new Response(JSON.stringify(answer)));
  });
  const [run, { signal }] = [new Run("7"), new AbortController()];
  await run.load(signal);
  expect([run.row?.outcome, asked]).toEqual([null, ["7", "p"]]);
  outcome = "simulated";
  await run.load(signal);
  await run.load(signal);
  expect([run.row?.outcome, run.reported, asked]).toEqual(["simulated", { t: [0, 1] }, ["7", "p", "7", "trace"]]);
});
