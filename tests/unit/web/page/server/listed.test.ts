import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignList } from "$lib/server/api.svelte";
import type { Campaign } from "$lib/server/types";

const PATH = "/campaigns?limit=2";

/** A server with a list: pages of two, a tag that changes with the page. */
let stored: Campaign[] = [];
let sent = 0;

const campaign = (id: number, name = `campaign ${id}`): Campaign => ({ id: String(id), name }) as Campaign;
const read = async (list: CampaignList, pages: number): Promise<[string[], boolean]> => {
  const { items, goesOn } = await list.read(pages);
  return [items.map((entry) => entry.id), goesOn];
};

async function answer(address: string, options: RequestInit): Promise<Response> {
  const cursor = new URLSearchParams(address.split("?")[1]).get("cursor");
  const older = stored.filter(({ id }) => cursor === null || Number(id) < Number(cursor));
  const items = older.slice(0, 2);
  const body = JSON.stringify({ items, next_cursor: older.length > 2 ? items.at(-1)?.id : null });
  const same = new Headers(options.headers).get("If-None-Match") === encodeURIComponent(body);
  if (!same) sent += 1;
  return same ? new Response(null, { status: 304 }) : new Response(body, { headers: { ETag: encodeURIComponent(body) } });
}

beforeEach(() => {
  [stored, sent] = [[5, 4, 3, 2, 1].map((id) => campaign(id)), 0];
  vi.stubGlobal("fetch", answer);
});
afterEach(() => void vi.unstubAllGlobals());

test("no campaign is listed twice, also when a newer one goes", async () => {
  const list = new CampaignList(PATH);
  await Promise.all([list.read(1), list.read(2)]);
  stored = stored.filter(({ id }) => id !== "5");
  expect(await read(list, 2)).toEqual([["4", "3", "2", "1"], false]);
});

test("older campaigns follow what changes, and unchanged pages are not sent again", async () => {
  const list = new CampaignList(PATH);
  await list.read(2);
  stored = stored.map((entry) => (entry.id === "3" ? campaign(3, "renamed") : entry));
  sent = 0;
  expect((await list.read(2)).items.map(({ name }) => name)).toEqual(["campaign 5", "campaign 4", "renamed", "campaign 2"]);
  expect(sent).toBe(1);
});
