/** Whole tables of the API in little memory: they come as CSV, piece by piece, and are kept column by column. */

export interface NumberColumn {
  kind: "number";
  name: string;
  /** NaN if there is none. */
  values: Float64Array;
}

export interface TextColumn {
  kind: "text";
  name: string;
  /** Indices of `words`; -1 if there is none. */
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

/** Reads CSV as it comes in. `text`: the names of the columns that hold no numbers. Others become text at their first word. */
export class CsvReader {
  private names: string[] | null = null;
  private readonly columns: Column[] = [];
  private readonly dictionaries: Map<string, number>[] = [];
  private rows = 0;
  private rest = "";

  constructor(private readonly text: Pick<ReadonlySet<string>, "has">) {}

  get length(): number {
    return this.rows;
  }

  push(piece: string): void {
    const lines = (this.rest + piece).split("\n");
    this.rest = lines.pop() ?? "";
    let begun = "";
    for (const line of lines) {
      const row = begun + line;
      // A line break inside quotes does not end a row.
      begun = row.includes('"') && row.split('"').length % 2 === 0 ? `${row}\n` : "";
      if (begun === "") this.read(row.endsWith("\r") ? row.slice(0, -1) : row);
    }
    this.rest = begun + this.rest;
  }

  /** All of it. */
  finish(): Table {
    if (this.rest !== "") this.push("\n");
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

  private read(row: string): void {
    if (row === "") return;
    const fields = row.includes('"') ? quotedFields(row) : row.split(",");
    if (this.names === null) this.begin(fields);
    else this.add(fields);
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
    this.columns.forEach((kept, index) => {
      const field = fields[index] ?? "";
      const column = kept.kind === "number" && field !== "" && Number.isNaN(Number(field)) ? this.inWords(kept, index, row) : kept;
      if (column.kind === "number") {
        if (row >= column.values.length) column.values = grown(column.values, new Float64Array(2 * row));
        column.values[row] = field === "" ? Number.NaN : Number(field);
      } else {
        if (row >= column.codes.length) column.codes = grown(column.codes, new Int32Array(2 * row));
        column.codes[row] = field === "" ? -1 : this.code(column, index, field);
      }
    });
  }

  /** Turns a column of numbers into text. */
  private inWords(column: NumberColumn, index: number, rows: number): TextColumn {
    const text: TextColumn = { kind: "text", name: column.name, codes: new Int32Array(column.values.length), words: [] };
    for (let row = 0; row < rows; row++) {
      const value = column.values[row] as number;
      text.codes[row] = Number.isNaN(value) ? -1 : this.code(text, index, String(value));
    }
    this.columns[index] = text;
    return text;
  }

  private code(column: TextColumn, index: number, word: string): number {
    const dictionary = this.dictionaries[index];
    const known = dictionary?.get(word);
    if (known !== undefined) return known;
    dictionary?.set(word, column.words.length);
    return column.words.push(unmarked(word)) - 1;
  }
}

function grown<T extends Float64Array | Int32Array>(old: T, roomy: T): T {
  roomy.set(old);
  return roomy;
}

function quotedFields(row: string): string[] {
  const fields = `,${row}`.matchAll(/,(?:"((?:[^"]|"")*)"|([^,]*))/g);
  return Array.from(fields, ([, quoted, plain]) => quoted?.replaceAll('""', '"') ?? plain ?? "");
}

/** Value of a cell for people and for comparisons; null if there is none. */
export function cell(table: Table, name: string, row: number): number | string | null {
  const column = table.columns[name];
  if (column === undefined) return null;
  if (column.kind === "text") return column.words[column.codes[row] ?? -1] ?? null;
  const value = column.values[row];
  return value === undefined || Number.isNaN(value) ? null : value;
}

/** The smallest and the largest number of a column; null if it has none. */
export function extent(table: Table, name: string): [number, number] | null {
  const column = table.columns[name];
  if (column?.kind !== "number") return null;
  let [low, high] = [Infinity, -Infinity];
  for (const value of column.values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return low <= high ? [low, high] : null;
}

/** The numbers of a drawing. */
export interface Sheet {
  head: readonly string[];
  rows: readonly (readonly (string | number | null)[])[];
}

/** Parts of a text that a spreadsheet would carry out as a formula, as in the server's files: with `;` or a tab as its separator, too. */
const FORMULA = /(^|[;\t\r\n])(?=[ "]*[=+\-@＝＋－＠]|[\t\r])([^;\t\r\n]*)/g;

function marked(text: string): string {
  if (!Number.isNaN(Number(text))) return text;
  return text.replaceAll(FORMULA, (part: string, separator: string, rest: string) => (rest !== "" && !Number.isNaN(Number(rest)) ? part : `${separator}'${rest}`));
}

/** A text of a file without the apostrophes that mark it as no formula. */
function unmarked(text: string): string {
  const plain = text.replaceAll(/(^|[;\t\r\n])'(?=[ "]*[=+\-@＝＋－＠]|[\t\r])/g, "$1");
  return marked(plain) === text ? plain : text;
}

export function csvOf(sheet: Sheet): string {
  const field = (value: string | number | null): string => {
    const text = value === null ? "" : marked(String(value));
    return /[",;\t\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [sheet.head, ...sheet.rows].map((row) => row.map(field).join(",")).join("\n") + "\n";
}
