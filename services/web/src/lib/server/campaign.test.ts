import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignState } from "./campaign.svelte";

/** A connection that opens at once and never closes. */
class Open {
  static readonly OPEN = 1;
  readonly readyState = 1;
  send(): void {}
  close(): void {}
}

let reached = false;

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("WebSocket", Open);
  vi.stubGlobal("location", { protocol: "http:", host: "here" });
  vi.stubGlobal("document", { hidden: false });
  vi.stubGlobal("fetch", async () => {
    if (!reached) throw new TypeError("no connection");
    return new Response(JSON.stringify({ id: "1", name: "first", kind: "evaluation", ended_at: "2026-01-01T00:00:00Z", stages: {} }));
  });
});
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("a campaign that could not be read is read as soon as the server answers, whatever the live connection says", async () => {
  const state = new CampaignState("1");
  const stop = state.start();
  await vi.advanceTimersByTimeAsync(2_500);
  expect([state.campaign, state.problem?.status]).toEqual([null, 0]);
  reached = true;
  await vi.advanceTimersByTimeAsync(2_500);
  expect([state.campaign?.name, state.problem]).toEqual(["first", null]);
  stop();
});
