/** A table of a campaign as the page holds it: whole, and read again when it has grown. */

import { parameterOf, type Ranged } from "../charts/axes";
import { Refusal, ask, reach } from "./api.svelte";
import { CsvReader, EMPTY, type Table } from "./columns";

/** Rows of a long table that are shown at once, and the growth until more of it is shown. */
const FIRST_SHOWN = 3_000;
const TIMES_AS_LONG = 4;
/** First rows of a table that is known to be long. */
const FIRST_OF_MANY = 200;

/** Columns of words, which may look like numbers. */
const WORDS = new Set(["stage", "scenario", "outcome", "failure", "worker"]);

export class TableState {
  table = $state.raw<Table>(EMPTY);
  /** Rows that were read so far, while it is being read. */
  reading = $state<number | null>(null);
  problem = $state("");
  /** The path whose rows the table has. */
  shown = $state("");
  /** Whether the table has all rows of its path. */
  whole = $state(false);
  /** The path that is being read, or was read last. */
  private path = "";
  private abort: AbortController | null = null;
  /** A table that was asked for, and is not read yet. */
  private ahead: { path: string; abort: AbortController; answer: Promise<Response> } | null = null;
  /** Asked for again while it is being read. */
  private again = false;

  /** `parameters`: choices are words, which may look like numbers. `expected`: the number of rows, as far as it is known. */
  constructor(private readonly parameters: () => readonly Pick<Ranged, "column" | "choices">[] = () => [], private readonly expected: () => number = () => 0) {}

  /** Asks for a table that is read later: its first rows come while other things do that the reading needs. */
  askFor(path: string): void {
    const abort = new AbortController();
    const answer = ask(path, { signal: abort.signal, headers: { Accept: "text/csv" } });
    const ahead = (this.ahead = { path, abort, answer });
    answer.catch(() => {
      if (this.ahead === ahead) this.ahead = null; // the reading asks again
    });
  }

  /** Reads a table, another one at once; the same one after the reading that is under way, which a fast search would never let end. */
  async load(path: string): Promise<void> {
    if (this.abort !== null && path === this.path) {
      this.again = true;
      return;
    }
    this.abort?.abort();
    if (this.ahead?.path !== path) this.askFor(path);
    const { abort, answer: asked } = this.ahead as NonNullable<typeof this.ahead>;
    [this.path, this.again, this.reading, this.abort, this.ahead] = [path, false, 0, abort, null];
    try {
      const answer = await asked;
      const reader = new CsvReader({ has: (name) => WORDS.has(name) || (parameterOf(name, this.parameters())?.choices ?? []).length > 0 });
      const stream = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
      let worth = this.expected() > FIRST_SHOWN ? FIRST_OF_MANY : FIRST_SHOWN;
      for (;;) {
        const piece = await stream?.read();
        if (piece === undefined || piece.done) break;
        reader.push(piece.value);
        if (this.abort !== abort) return;
        this.reading = reader.length;
        if (reader.length < worth) continue;
        worth = Math.max(FIRST_SHOWN, TIMES_AS_LONG * reader.length);
        if (path === this.shown && reader.length <= this.table.length) continue;
        [this.table, this.shown, this.whole] = [reader.soFar(), path, false];
      }
      if (this.abort !== abort) return;
      [this.table, this.shown, this.whole, this.problem] = [reader.finish(), path, true, ""];
    } catch (error) {
      if (abort.signal.aborted) return;
      this.problem = error instanceof Refusal ? error.message : `The table broke off: ${String(error)}`;
    }
    [this.abort, this.reading] = [null, null];
    if (this.again) void this.load(path);
  }

  stop(): void {
    this.abort?.abort();
    this.ahead?.abort.abort();
    [this.abort, this.ahead, this.again] = [null, null, false];
  }
}

/** A table that is read when a view opens, and again when anything changes that `path` reads, and when the server is back. */
export function tableAt(path: () => string, ...known: ConstructorParameters<typeof TableState>): TableState {
  const table = new TableState(...known);
  $effect(() => {
    void reach.returns;
    void table.load(path());
  });
  $effect(() => () => table.stop());
  return table;
}
