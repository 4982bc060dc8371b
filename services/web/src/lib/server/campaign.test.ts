import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignState } from "./campaign.svelte";

let reached = false;

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("document", { hidden: false, addEventListener: () => undefined, removeEventListener: () => undefined });
  vi.stubGlobal("fetch", async (address: string) => {
    if (address.endsWith("/events")) return await new Promise(() => undefined); // a stream that says nothing
    if (!reached) throw new TypeError("no connection");
    return new Response(JSON.stringify({ id: "1", name: "first", kind: "evaluation", ended_at: "2026-01-01T00:00:00Z", stages: {} }));
  });
});
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("a campaign that could not be read is read as soon as the server answers, whatever its event stream says", async () => {
  const state = new CampaignState("1");
  const stop = state.start();
  await vi.advanceTimersByTimeAsync(2_500);
  expect([state.campaign, state.problem?.status]).toEqual([null, 0]);
  reached = true;
  await vi.advanceTimersByTimeAsync(2_500);
  expect([state.campaign?.name, state.problem]).toEqual(["first", null]);
  stop();
});
