/** A table that is asked for before its view is there: its rows come while the campaign and the script of the view do. */

import { ask } from "./api";

interface Ahead {
  path: string;
  abort: AbortController;
  answer: Promise<Response>;
}

let held: Ahead | null = null;

/** Asks for a table. Throws a Refusal for every error status. */
export function askTable(path: string, signal: AbortSignal): Promise<Response> {
  return ask(path, { signal, headers: { Accept: "text/csv" } });
}

/** Asks for a table that `taken` hands on. A refusal is forgotten: who reads the table then asks again. */
export function askAhead(path: string): void {
  giveUp();
  const abort = new AbortController();
  const asked: Ahead = { path, abort, answer: askTable(path, abort.signal) };
  held = asked;
  asked.answer.catch(() => {
    if (held === asked) held = null;
  });
}

/** The table of this path that was asked for ahead, for once; null without one. */
export function taken(path: string): Ahead | null {
  const found = held?.path === path ? held : null;
  if (found !== null) held = null;
  return found;
}

/** Stops what was asked for ahead, unless it was taken. */
export function giveUp(): void {
  held?.abort.abort();
  held = null;
}
