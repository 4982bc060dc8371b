import { afterEach, expect, test, vi } from "vitest";
import { all, ask, newKey, whenRefused } from "$lib/server/api.svelte";

afterEach(() => vi.unstubAllGlobals());

test("a key of a request needs nothing that a page of plain http lacks, and differs from the last", () => {
  vi.stubGlobal("crypto", { getRandomValues: crypto.getRandomValues.bind(crypto) });
  expect(newKey()).toMatch(/^[0-9a-f]{32}$/);
  expect(newKey()).not.toBe(newKey());
});

test("a list is read to its end, however many pages it has", async () => {
  let page = 0;
  vi.stubGlobal("fetch", async () => new Response(JSON.stringify({ items: Array.from({ length: 1000 }, () => 0), next_cursor: ++page < 22 ? String(page) : null })));
  expect(await all("/front")).toHaveLength(22_000);
});

test("after the end of a session nothing but a new one is asked for", async () => {
  const asked: string[] = [];
  let refusals = 0;
  let isKnown = false;
  whenRefused(() => refusals++);
  vi.stubGlobal("fetch", async (path: string) => {
    asked.push(path);
    return new Response("{}", { status: isKnown ? 200 : 401 });
  });
  for (const path of ["/workers", "/campaigns", "/session"]) await expect(ask(path)).rejects.toMatchObject({ status: 401 });
  expect([asked, refusals]).toEqual([["/api/v1/workers", "/api/v1/session"], 2]);
  isKnown = true;
  await ask("/session", { method: "POST" });
  await ask("/workers");
  expect(asked.slice(2)).toEqual(["/api/v1/session", "/api/v1/workers"]);
});
