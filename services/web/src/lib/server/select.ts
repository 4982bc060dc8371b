/** Which rows of a table are wanted, and in which order. */

import type { Table } from "./columns";

export interface Wanted {
  /** By column, the words that are wanted; any where it is not named. */
  words: Readonly<Record<string, readonly string[]>>;
  /** By column, the inclusive range; rows without a number are not in it. */
  ranges: Readonly<Record<string, readonly [number, number]>>;
}

export function select(table: Table, wanted: Wanted): Uint32Array {
  const kept = new Uint8Array(table.length).fill(1);
  for (const [name, words] of Object.entries(wanted.words)) {
    const column = table.columns[name];
    if (column?.kind !== "text" || words.length === 0) continue;
    const fits = column.words.map((word) => words.includes(word));
    column.codes.forEach((code, row) => {
      if (fits[code] !== true) kept[row] = 0;
    });
  }
  for (const [name, [low, high]] of Object.entries(wanted.ranges)) {
    const column = table.columns[name];
    if (column?.kind !== "number") continue;
    column.values.forEach((value, row) => {
      if (!(value >= low && value <= high)) kept[row] = 0;
    });
  }
  return numbered(table.length).filter((row) => kept[row] === 1);
}

/** The rows ordered by a column; those without a value come last, equal ones stay in their order. */
export function ordered(table: Table, rows: Uint32Array, name: string, descending: boolean): Uint32Array {
  const column = table.columns[name];
  if (column === undefined) return rows;
  const sign = descending ? -1 : 1;
  const keys = column.kind === "number" ? column.values : ranks(column.words, column.codes);
  return rows.slice().sort((row, other) => {
    const a = keys[row] as number;
    const b = keys[other] as number;
    if (Number.isNaN(a)) return Number.isNaN(b) ? row - other : 1;
    if (Number.isNaN(b)) return -1;
    return a === b ? row - other : sign * (a - b);
  });
}

function ranks(words: readonly string[], codes: Int32Array): Float64Array {
  const inOrder = words.map((_, code) => code).sort((a, b) => (words[a] ?? "").localeCompare(words[b] ?? "", "en", { numeric: true }));
  const rank = new Float64Array(words.length);
  inOrder.forEach((code, at) => (rank[code] = at));
  return Float64Array.from(codes, (code) => (code < 0 ? Number.NaN : (rank[code] as number)));
}

/** How many rows have each word of a column, in the order of the words. */
export function tally(table: Table, name: string): [string, number][] {
  const column = table.columns[name];
  if (column?.kind !== "text") return [];
  const counts = new Uint32Array(column.words.length);
  for (const code of column.codes) if (code >= 0) counts[code] = (counts[code] ?? 0) + 1;
  return column.words
    .map((word, code): [string, number] => [word, counts[code] ?? 0])
    .sort(([a], [b]) => a.localeCompare(b, "en", { numeric: true }));
}

/** The numbers from 0 on. */
export function numbered(length: number): Uint32Array {
  return new Uint32Array(length).map((_, row) => row);
}

/** Rows by the size of a value: first those without one, then `count` equal parts from `lower` to `upper`, each in the order of the rows. */
export function binned(rows: Uint32Array, values: Float64Array | null, lower: number, upper: number, count: number): Uint32Array[] {
  const scale = count / (upper - lower || 1);
  const bins = Array.from({ length: count + 1 }, (): number[] => []);
  for (const row of rows) {
    const value = values?.[row] ?? Number.NaN;
    const part = Number.isNaN(value) ? 0 : 1 + Math.min(count - 1, Math.max(0, Math.floor((value - lower) * scale)));
    bins[part]?.push(row);
  }
  return bins.map((bin) => new Uint32Array(bin));
}
