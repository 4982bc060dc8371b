import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { deleted, relabelled } from "./labelling";

const CAMPAIGNS = [{ id: "a", name: "first" }, { id: "b", name: "second" }, { id: "c", name: "third" }];
const REFERRING = [{ campaign: "d".repeat(32), name: "study", use: "rerun of it" }];
let asked: [string, string, unknown][] = [];

/** A server that refuses the second campaign, and archives the third instead of deleting it. */
async function answer(address: string, options: RequestInit): Promise<Response> {
  asked.push([options.method ?? "GET", address, options.body === undefined ? undefined : JSON.parse(String(options.body))]);
  if (address.endsWith("/b")) return new Response(JSON.stringify({ detail: "it is running" }), { status: 409 });
  return new Response(JSON.stringify({ deleted: address.endsWith("/a"), referring: REFERRING }));
}

beforeEach(() => {
  asked = [];
  vi.stubGlobal("fetch", answer);
});
afterEach(() => void vi.unstubAllGlobals());

test("tags are sent by themselves, so that those of others stay", async () => {
  await relabelled(CAMPAIGNS.slice(0, 1), { add_tags: ["good", "car-7"] });
  await relabelled(CAMPAIGNS.slice(0, 1), { remove_tags: ["good"] });
  expect(asked).toEqual([
    ["PATCH", "/api/v1/campaigns/a", { add_tags: ["good", "car-7"] }],
    ["PATCH", "/api/v1/campaigns/a", { remove_tags: ["good"] }],
  ]);
});

test("a campaign that is refused holds up no other, and is named with the reason", async () => {
  const { done, refusals } = await relabelled(CAMPAIGNS, { archived: true });
  expect(done).toEqual(["a", "c"]);
  expect(refusals).toEqual(["second: it is running"]);
});

test("what is archived instead of being deleted is changed, and a refusal with its reason", async () => {
  const { done, refusals } = await deleted(CAMPAIGNS);
  expect(done).toEqual(["a", "c"]);
  expect(refusals[0]).toBe("second: it is running");
  expect(refusals[1]).toContain("study (dddddddd, rerun of it)");
});
