import { afterEach, expect, test, vi } from "vitest";
import { askAhead, giveUp, taken } from "./ahead";
import { quietFor } from "./api";
import { TableState } from "./table.svelte";

afterEach(() => {
  giveUp();
  vi.unstubAllGlobals();
});

/** Answers each request with a table, and lists the paths and whether the last one was given up. */
function server(answer: () => Promise<Response>): { asked: string[]; signals: AbortSignal[] } {
  const [asked, signals]: [string[], AbortSignal[]] = [[], []];
  vi.stubGlobal("fetch", (path: string, { signal }: { signal: AbortSignal }) => {
    asked.push(path);
    signals.push(signal);
    return answer();
  });
  return { asked, signals };
}

test("a table that was asked for ahead is asked for once, and for its own path alone", async () => {
  const { asked } = server(async () => new Response("id\n1\n"));
  const rows = new TableState("EvaluationRow");
  askAhead("/evaluations");
  await rows.load("/others");
  expect(asked).toHaveLength(2);
  await rows.load("/evaluations");
  expect([asked.length, rows.table.length, rows.whole]).toEqual([2, 1, true]);
  await rows.load("/evaluations");
  expect(asked).toHaveLength(3);
});

test("what was refused ahead is asked for again by who reads it, and what nobody reads is given up", async () => {
  let answers = 0;
  const { asked, signals } = server(async () => (answers++ === 0 ? new Response("{}", { status: 503 }) : new Response("id\n1\n")));
  askAhead("/evaluations");
  await vi.waitUntil(() => quietFor() > 0);
  await new Promise((done) => setTimeout(done));
  expect(taken("/evaluations")).toBeNull();
  const rows = new TableState("EvaluationRow");
  await rows.load("/evaluations");
  expect([asked.length, rows.problem, rows.table.length]).toEqual([2, "", 1]);
  askAhead("/evaluations");
  giveUp();
  expect([signals[2]?.aborted, taken("/evaluations")]).toEqual([true, null]);
});

test("the first rows of a long table are shown at once, and while they are awaited the page is not quiet", async () => {
  let stream: ReadableStreamDefaultController<Uint8Array> | undefined;
  server(async () => new Response(new ReadableStream({ start: (opened) => void (stream = opened) })));
  const rows = new TableState("EvaluationRow", () => [], () => 12_000);
  const read = rows.load("/evaluations");
  await new Promise((done) => setTimeout(done, 20));
  expect(quietFor()).toBe(0);
  stream?.enqueue(new TextEncoder().encode(`id\n${"1\n".repeat(300)}`));
  await vi.waitUntil(() => quietFor() > 0);
  expect([rows.table.length, rows.whole]).toEqual([300, false]);
  stream?.close();
  await read;
});
