import { afterEach, expect, test, vi } from "vitest";
import { all, ask, start, whenRefused } from "$lib/server/api.svelte";

afterEach(() => vi.unstubAllGlobals());

test("what is started again has the same key until it has started", async () => {
  vi.stubGlobal("crypto", { getRandomValues: crypto.getRandomValues.bind(crypto) }); // all that a page of plain http has
  const keys: (string | null)[] = [];
  let isAway = true;
  vi.stubGlobal("fetch", async (_: string, options: RequestInit) => {
    keys.push(new Headers(options.headers).get("Idempotency-Key"));
    return isAway ? Promise.reject(new TypeError("away")) : new Response("{}");
  });
  await expect(start("/campaigns", { name: "a" })).rejects.toThrow();
  isAway = false;
  for (const name of ["a", "a", "b"]) await start("/campaigns", { name });
  expect(keys[0]).toMatch(/^[0-9a-f]{32}$/);
  expect(keys[1]).toBe(keys[0]);
  expect(new Set(keys).size).toBe(3);
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
