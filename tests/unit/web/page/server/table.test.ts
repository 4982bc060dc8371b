import { afterEach, expect, test, vi } from "vitest";
import { TableState } from "$lib/server/table.svelte";

afterEach(() => void vi.unstubAllGlobals());

/** Answers that come when the test sends them, by the number of their request. */
function answers(): { asked: string[]; send: (request: number, csv: string, last?: boolean) => Promise<void> } {
  const asked: string[] = [];
  const streams: ReadableStreamDefaultController<Uint8Array>[] = [];
  vi.stubGlobal("fetch", async (path: string, { signal }: { signal: AbortSignal }) => {
    asked.push(path);
    return new Response(new ReadableStream({ start: (stream) => { streams.push(stream); signal.addEventListener("abort", () => stream.error(signal.reason)); } }));
  });
  return {
    asked,
    async send(request, csv, last = true) {
      await vi.waitUntil(() => streams.length > request);
      streams[request]?.enqueue(new TextEncoder().encode(csv));
      if (last) streams[request]?.close();
      await new Promise((done) => setTimeout(done, 20));
    },
  };
}

test("rows of another path are known to be old until the first rows of the new one are here, also if there are fewer", async () => {
  const { send } = answers();
  const rows = new TableState();
  const many = `rank,objective\n${Array.from({ length: 9_000 }, (_, row) => `${row},1\n`).join("")}`;
  void rows.load("/solutions");
  await send(0, many);
  expect([rows.shown, rows.whole, rows.table.length]).toEqual(["/solutions", true, 9_000]);
  void rows.load("/solutions?weights=S1=2");
  expect(rows.shown).toBe("/solutions");
  await send(1, many.slice(0, many.length / 2), false);
  expect([rows.shown, rows.whole, rows.reading]).toEqual(["/solutions?weights=S1=2", false, rows.table.length]);
  await send(1, many.slice(many.length / 2));
  expect([rows.whole, rows.reading, rows.table.length]).toEqual([true, null, 9_000]);
});

test("a table that grows faster than it can be read is read to its end, then once more", async () => {
  const { asked, send } = answers();
  const rows = new TableState();
  for (let moment = 0; moment < 3; moment++) void rows.load("/solutions");
  await send(0, "rank\n1\n");
  expect([rows.table.length, asked.length]).toEqual([1, 2]);
  await send(1, "rank\n1\n2\n");
  expect([rows.table.length, rows.reading, asked.length]).toEqual([2, null, 2]);
});

test("a table that was asked for ahead is asked for once, and for its own path alone", async () => {
  const { asked, send } = answers();
  const rows = new TableState();
  rows.askFor("/solutions");
  void rows.load("/solutions");
  await send(0, "rank\n1\n");
  expect([rows.table.length, asked.length]).toEqual([1, 1]);
  rows.askFor("/solutions");
  void rows.load("/others");
  await send(2, "rank\n1\n2\n");
  expect([rows.table.length, rows.shown, asked.length]).toEqual([2, "/others", 3]);
});

test("a table that was refused ahead is asked for again", async () => {
  let answers = 0;
  vi.stubGlobal("fetch", async () => (answers++ === 0 ? new Response("{}", { status: 503 }) : new Response("rank\n1\n")));
  const rows = new TableState();
  rows.askFor("/solutions");
  await new Promise((done) => setTimeout(done, 20));
  await rows.load("/solutions");
  expect([answers, rows.problem, rows.table.length]).toEqual([2, "", 1]);
});

test("the first rows of a long table are shown at once", async () => {
  const { send } = answers();
  const rows = new TableState(() => [], () => 12_000);
  void rows.load("/evaluations");
  await send(0, `id\n${"1\n".repeat(300)}`, false);
  expect([rows.table.length, rows.whole]).toEqual([300, false]);
});
