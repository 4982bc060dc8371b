import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignState } from "$lib/server/campaign.svelte";

const ended = { id: "a", kind: "evaluation", state: "succeeded", ended_at: "2026-01-01" };
/** Sends a message of the event stream. */
let send: (kind: string, data: unknown) => void;

beforeEach(() => {
  vi.stubGlobal("document", { hidden: false, addEventListener: () => undefined, removeEventListener: () => undefined });
  vi.stubGlobal("fetch", (address: string) => {
    if (!address.endsWith("/events")) return Promise.resolve(new Response(JSON.stringify(ended)));
    const body = new ReadableStream({ start: (stream) => void (send = (kind, data) => stream.enqueue(new TextEncoder().encode(`event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`))) });
    return Promise.resolve(new Response(body));
  });
});
afterEach(() => void vi.unstubAllGlobals());

test("progress that was on its way when the end was read moves nothing back", async () => {
  const live = new CampaignState("a");
  const stop = live.start();
  await vi.waitFor(() => expect(live.campaign?.state).toBe("succeeded"));
  send("progress", { state: "running" });
  send("note", { id: 1, kind: "note", at: "", text: "", data: {} });
  await vi.waitFor(() => expect(live.events.length).toBe(1));
  expect(live.campaign?.state).toBe("succeeded");
  stop();
});
