/** Whole tables of the API in little memory: they come as CSV, piece by piece, and are kept column by column. */

export interface NumberColumn {
  kind: "number";
  name: string;
  /** NaN where there is none. */
  values: Float64Array;
}

export interface TextColumn {
  kind: "text";
  name: string;
  /** Indices of `words`; -1 where there is none. */
  codes: Int32Array;
  words: string[];
}

export type Column = NumberColumn | TextColumn;

export interface Table {
  length: number;
  names: readonly string[];
  columns: Readonly<Record<string, Column>>;
}

export const EMPTY: Table = { length: 0, names: [], columns: {} };

const FIRST_CAPACITY = 1024;

/** Reads CSV as it comes in. `text`: the names of the columns that hold no numbers. */
export class CsvReader {
  private names: string[] | null = null;
  private readonly columns: Column[] = [];
  private readonly dictionaries: Map<string, number>[] = [];
  private rows = 0;
  private rest = "";

  constructor(private readonly text: ReadonlySet<string>) {}

  get length(): number {
    return this.rows;
  }

  push(piece: string): void {
    const content = this.rest + piece;
    // A line break inside quotes does not end a row: wait until all quotes are closed.
    const end = content.includes('"') ? endOfRows(content) : content.lastIndexOf("\n") + 1;
    this.rest = content.slice(end);
    this.read(content.slice(0, end));
  }

  /** All of it. */
  finish(): Table {
    if (this.rest !== "") {
      this.read(this.rest.endsWith("\n") ? this.rest : `${this.rest}\n`);
      this.rest = "";
    }
    return this.soFar();
  }

  /** What was read, without the room for more; what is read after that does not change it. */
  soFar(): Table {
    const columns: Record<string, Column> = {};
    for (const column of this.columns) {
      columns[column.name] =
        column.kind === "number" ? { ...column, values: column.values.slice(0, this.rows) } : { ...column, codes: column.codes.slice(0, this.rows), words: [...column.words] };
    }
    return { length: this.rows, names: this.names ?? [], columns };
  }

  private read(lines: string): void {
    const rows = lines.includes('"') ? quotedRows(lines) : plainRows(lines);
    for (const fields of rows) {
      if (this.names === null) this.begin(fields);
      else this.add(fields);
    }
  }

  private begin(names: string[]): void {
    this.names = names;
    for (const name of names) {
      this.columns.push(
        this.text.has(name)
          ? { kind: "text", name, codes: new Int32Array(FIRST_CAPACITY), words: [] }
          : { kind: "number", name, values: new Float64Array(FIRST_CAPACITY) },
      );
      this.dictionaries.push(new Map());
    }
  }

  private add(fields: string[]): void {
    const row = this.rows++;
    this.columns.forEach((column, index) => {
      const field = fields[index] ?? "";
      if (column.kind === "number") {
        if (row >= column.values.length) column.values = grown(column.values, new Float64Array(2 * row));
        column.values[row] = field === "" ? Number.NaN : Number(field);
      } else {
        if (row >= column.codes.length) column.codes = grown(column.codes, new Int32Array(2 * row));
        column.codes[row] = field === "" ? -1 : this.code(column, index, field);
      }
    });
  }

  private code(column: TextColumn, index: number, word: string): number {
    const dictionary = this.dictionaries[index];
    const known = dictionary?.get(word);
    if (known !== undefined) return known;
    dictionary?.set(word, column.words.length);
    return column.words.push(word) - 1;
  }
}

function grown<T extends Float64Array | Int32Array>(old: T, roomy: T): T {
  roomy.set(old);
  return roomy;
}

function* plainRows(lines: string): Generator<string[]> {
  for (const line of lines.split("\n")) {
    const kept = line.endsWith("\r") ? line.slice(0, -1) : line;
    if (kept !== "") yield kept.split(",");
  }
}

/** Where the last complete row ends: after a line break that is not quoted. */
function endOfRows(content: string): number {
  let quoted = false;
  let end = 0;
  for (let at = 0; at < content.length; at++) {
    const sign = content[at];
    if (sign === '"') quoted = !quoted;
    else if (sign === "\n" && !quoted) end = at + 1;
  }
  return end;
}

function* quotedRows(lines: string): Generator<string[]> {
  let fields: string[] = [];
  let field = "";
  let quoted = false;
  for (let at = 0; at < lines.length; at++) {
    const sign = lines[at];
    if (quoted) {
      if (sign !== '"') field += sign;
      else if (lines[at + 1] === '"') {
        field += '"';
        at += 1;
      } else quoted = false;
    } else if (sign === '"') quoted = true;
    else if (sign === ",") {
      fields.push(field);
      field = "";
    } else if (sign === "\n") {
      fields.push(field.endsWith("\r") ? field.slice(0, -1) : field);
      if (fields.length > 1 || fields[0] !== "") yield fields;
      fields = [];
      field = "";
    } else field += sign;
  }
}

/** Value of a cell for people and for comparisons; null where there is none. */
export function cell(table: Table, name: string, row: number): number | string | null {
  const column = table.columns[name];
  if (column === undefined) return null;
  if (column.kind === "text") return column.words[column.codes[row] ?? -1] ?? null;
  const value = column.values[row];
  return value === undefined || Number.isNaN(value) ? null : value;
}

/** The smallest and the largest number of a column; null where it has none. */
export function extent(table: Table, name: string): [number, number] | null {
  const column = table.columns[name];
  if (column?.kind !== "number") return null;
  let low = Infinity;
  let high = -Infinity;
  for (const value of column.values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return low <= high ? [low, high] : null;
}
