import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignState } from "$lib/server/campaign.svelte";

const ended = { id: "a", kind: "evaluation", state: "succeeded", ended_at: "2026-01-01" };
/** The event stream. */
let source: Source;
class Source extends EventTarget {
  constructor() {
    super();
    source = this;
  }
  close(): void {}
}
const send = (kind: string, data: unknown): boolean => source.dispatchEvent(new MessageEvent(kind, { data: JSON.stringify(data) }));

beforeEach(() => {
  vi.stubGlobal("document", { hidden: false, addEventListener: () => undefined, removeEventListener: () => undefined });
  vi.stubGlobal("fetch", async () => new Response(JSON.stringify(ended)));
  vi.stubGlobal("EventSource", Source);
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
