/** A table of a campaign as the page holds it: whole, and read again when it has grown. */

import { parameterOf, type Ranged } from "../charts/axes";
import { Refusal, ask } from "./api";
import { CsvReader, EMPTY, type Table } from "./columns";
import { columnsOf, type RowName } from "./rows";

/** Of a long table the beginning is shown at once, and more of it each time that it has become so many times as long. */
const FIRST_SHOWN = 3_000;
const TIMES_AS_LONG = 4;

export class TableState {
  table = $state.raw<Table>(EMPTY);
  /** The columns that rows of this kind have: whether each holds numbers. Columns besides these hold numbers, except choices. */
  readonly columns: ReadonlyMap<string, boolean>;
  /** Rows that were read so far, while it is being read. */
  reading = $state<number | null>(null);
  problem = $state("");
  private abort: AbortController | null = null;

  /** `parameters`: those with choices hold words, which may look like numbers. */
  constructor(row: RowName, private readonly parameters: () => readonly Ranged[] = () => []) {
    this.columns = columnsOf(row);
  }

  /** Whether a column holds words. */
  private isText(name: string): boolean {
    const numeric = this.columns.get(name);
    return numeric === undefined ? (parameterOf(name, this.parameters())?.choices ?? []).length > 0 : !numeric;
  }

  async load(path: string): Promise<void> {
    this.abort?.abort();
    const abort = (this.abort = new AbortController());
    this.reading = 0;
    try {
      const answer = await ask(path, { signal: abort.signal, headers: { Accept: "text/csv" } });
      const reader = new CsvReader({ has: (name) => this.isText(name) });
      const stream = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
      let worth = FIRST_SHOWN;
      for (;;) {
        const piece = await stream?.read();
        if (piece === undefined || piece.done) break;
        reader.push(piece.value);
        if (this.abort !== abort) return;
        this.reading = reader.length;
        if (reader.length < worth) continue;
        worth = TIMES_AS_LONG * reader.length;
        if (reader.length > this.table.length) this.table = reader.soFar();
      }
      if (this.abort !== abort) return;
      this.table = reader.finish();
      this.problem = "";
    } catch (error) {
      if (abort.signal.aborted) return;
      this.problem = error instanceof Refusal ? error.message : `The table broke off: ${String(error)}`;
    }
    this.reading = null;
  }

  stop(): void {
    this.abort?.abort();
    this.abort = null;
  }
}
