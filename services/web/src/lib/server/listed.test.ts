import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { CampaignList } from "./listed.svelte";
import type { Campaign } from "./types";

const PATH = "/campaigns?limit=2";

/** A server with a list: pages of two, a tag that changes with the page. */
let stored: Campaign[] = [];
let asked: string[] = [];
let sent = 0;
let broken = false;

const campaign = (id: number, name = `campaign ${id}`): Campaign => ({ id: String(id), name }) as Campaign;
const listed = (list: CampaignList): string[] => (list.items ?? []).map((entry) => entry.id);

async function answer(address: string, options: RequestInit): Promise<Response> {
  asked.push(address);
  if (broken) return new Response(JSON.stringify({ detail: "out of order" }), { status: 503 });
  const cursor = new URLSearchParams(address.split("?")[1]).get("cursor");
  const older = stored.filter(({ id }) => cursor === null || Number(id) < Number(cursor));
  const items = older.slice(0, 2);
  const body = JSON.stringify({ items, next_cursor: older.length > 2 ? items.at(-1)?.id : null });
  const same = new Headers(options.headers).get("If-None-Match") === encodeURIComponent(body);
  if (!same) sent += 1;
  return same ? new Response(null, { status: 304 }) : new Response(body, { headers: { ETag: encodeURIComponent(body) } });
}

beforeEach(() => {
  [stored, asked, sent, broken] = [[5, 4, 3, 2, 1].map((id) => campaign(id)), [], 0, false];
  vi.stubGlobal("fetch", answer);
});
afterEach(() => void vi.unstubAllGlobals());

test("older campaigns stay when the newest page moves on", async () => {
  const list = new CampaignList(PATH);
  await list.read();
  await list.more();
  expect([listed(list), list.goesOn]).toEqual([["5", "4", "3", "2"], true]);
  stored = [campaign(7), campaign(6), ...stored];
  await list.read();
  expect(listed(list)).toEqual(["7", "6", "5", "4"]);
  await list.more();
  await list.more();
  expect([listed(list), list.goesOn]).toEqual([["7", "6", "5", "4", "3", "2", "1"], false]);
});

test("no campaign is listed twice, also when a newer one goes", async () => {
  const list = new CampaignList(PATH);
  await Promise.all([list.read(), list.more()]);
  stored = stored.filter(({ id }) => id !== "5");
  await list.read();
  expect(listed(list)).toEqual(["4", "3", "2", "1"]);
});

test("older campaigns follow what changes, and unchanged pages are not sent again", async () => {
  const list = new CampaignList(PATH);
  await list.more();
  stored = stored.map((entry) => (entry.id === "3" ? campaign(3, "renamed") : entry));
  sent = 0;
  await list.read();
  expect(list.items?.map(({ name }) => name)).toEqual(["campaign 5", "campaign 4", "renamed", "campaign 2"]);
  expect(sent).toBe(1);
});

test("what was read stays while the server is out of order", async () => {
  const list = new CampaignList(PATH);
  await list.more();
  broken = true;
  await list.read();
  expect([listed(list), list.problem]).toEqual([["5", "4", "3", "2"], "out of order"]);
  broken = false;
  await list.read();
  expect(list.problem).toBe("");
});
