import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { deleted, relabelled } from "$lib/server/labelling";

const CAMPAIGNS = [{ id: "a", name: "first" }, { id: "b", name: "second" }, { id: "c", name: "third" }];
let asked: [string, string, unknown][] = [];

/** A server that refuses the second campaign. */
async function answer(address: string, options: RequestInit): Promise<Response> {
  asked.push([options.method ?? "GET", address, options.body === undefined ? undefined : JSON.parse(String(options.body))]);
  if (address.endsWith("/b")) return new Response(JSON.stringify({ detail: "it is running" }), { status: 409 });
  return options.method === "DELETE" ? new Response(null, { status: 204 }) : new Response("{}");
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
  const { done, refusals } = await relabelled(CAMPAIGNS, { add_tags: ["good"] });
  expect(done).toEqual(["a", "c"]);
  expect(refusals).toEqual(["second: it is running"]);
});

test("a campaign that is not deleted holds up no other, and is named with the reason", async () => {
  const { done, refusals } = await deleted(CAMPAIGNS);
  expect(done).toEqual(["a", "c"]);
  expect(refusals).toEqual(["second: it is running"]);
});
