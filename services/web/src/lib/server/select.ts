/** Selections of rows of a table, and their order. */

import { chosen, positions } from "../charts/axes";
import type { Axis } from "../charts/polylines";
import type { Table } from "./columns";

export interface Wanted {
  /** By column, the words that are wanted; any if it is not named. */
  words: Readonly<Record<string, readonly string[]>>;
  /** By column, the inclusive range; rows without a number are not in it. */
  ranges: Readonly<Record<string, readonly [number, number]>>;
  /** Of texts, ranges are places among the choices of their axis. */
  axes?: readonly Axis[];
}

// Plain loops over typed arrays: callbacks take several times as long, and a brush selects among all rows within a frame.

export function select(table: Table, wanted: Wanted): Uint32Array {
  const kept = new Uint8Array(table.length).fill(1);
  for (const [name, words] of Object.entries(wanted.words)) {
    const column = table.columns[name];
    if (column?.kind !== "text" || words.length === 0) continue;
    const fits = column.words.map((word) => words.includes(word));
    for (let row = 0; row < kept.length; row++) if (fits[column.codes[row] as number] !== true) kept[row] = 0;
  }
  for (const [name, [low, high]] of Object.entries(wanted.ranges)) {
    const values = positions(table, wanted.axes?.find((entry) => entry.name === name) ?? { name });
    // A range of a column that this table does not have keeps all of it.
    for (let row = 0; row < values.length; row++) if (!((values[row] as number) >= low && (values[row] as number) <= high)) kept[row] = 0;
  }
  return picked(numbered(kept.length), (row) => kept[row] === 1);
}

/** The `rows` that are in a selection, in their order. */
export function within(rows: Uint32Array, selected: Uint32Array): Uint32Array {
  const kept = new Uint8Array(rows.length);
  for (const row of selected) kept[row] = 1;
  return picked(rows, (row) => kept[row] === 1);
}

/** The rows that are wanted, in their order. */
function picked(rows: Uint32Array, wanted: (row: number) => boolean): Uint32Array {
  const kept = new Uint32Array(rows.length);
  let count = 0;
  for (let place = 0; place < rows.length; place++) {
    const row = rows[place] as number;
    if (wanted(row)) kept[count++] = row;
  }
  return kept.slice(0, count);
}

/** The selection as conditions of the API, for files and commands. */
export function conditions({ words, ranges, axes = [] }: Wanted): string[] {
  const kept = new Map(Object.entries(words).filter(([, values]) => values.length > 0));
  const bounds = Object.entries(ranges).flatMap(([name, [low, high]]) => {
    const axis = axes.find((entry) => entry.name === name && entry.choices);
    if (!axis) return [...(Number.isFinite(low) ? [`${name}>=${low}`] : []), ...(Number.isFinite(high) ? [`${name}<=${high}`] : [])];
    // To the API words of a column are alternatives: a range of its choices keeps some of the wanted words.
    const within = chosen(axis, [low, high]);
    kept.set(name, kept.get(name)?.filter((word) => within.includes(word)) ?? within);
    return [];
  });
  const alternatives = [...kept].flatMap(([name, values]) => (values.length > 0 ? values : [""]).map((value) => `${name}=${value}`));
  return [...alternatives, ...bounds];
}

/** Which lines are drawn of many: the best share of the search. */
export interface Share {
  by: string;
  /** 1 where more is better, else -1. */
  sign: number;
  share: number;
  /** The least number of lines. */
  least: number;
}

/** The rows that are drawn, in their order: the best share of them by a column, of the search alone where other stages are among them. */
export function drawn(table: Table, rows: Uint32Array, { by, sign, share, least }: Share): Uint32Array {
  const column = table.columns[by];
  if (share >= 1 || rows.length <= least || column?.kind !== "number") return rows;
  const { values } = column;
  const stages = table.columns["stage"];
  const search = stages?.kind === "text" ? stages.words.indexOf("calibration") : -1;
  const searched = search < 0 || stages?.kind !== "text" ? rows : picked(rows, (row) => stages.codes[row] === search);
  const known = picked(searched.length > 0 ? searched : rows, (row) => !Number.isNaN(values[row]));
  const most = Math.max(least, Math.ceil(share * known.length));
  if (known.length <= most) return known;
  // The worst value that is drawn decides.
  const worth = new Float64Array(known.length);
  for (let place = 0; place < known.length; place++) worth[place] = sign * (values[known[place] as number] as number);
  const last = worth.slice().sort()[known.length - most] as number;
  let equals = most;
  for (const value of worth) if (value > last) equals -= 1;
  return picked(known, (row) => {
    const value = sign * (values[row] as number);
    return value > last || (value === last && equals-- > 0);
  });
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

/** The numbers from 0 to `length` - 1. */
export function numbered(length: number): Uint32Array {
  const numbers = new Uint32Array(length);
  for (let row = 0; row < length; row++) numbers[row] = row;
  return numbers;
}

/** Rows by the size of a value: first those without one, then `count` equal parts from `lower` to `upper`, which may be less, each in the order of the rows. */
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

/** The places from `first` on, by the lines that show them: as long as a place is among them, it stays in its line. */
export function recycled(first: number, lines: number): number[] {
  return Array.from({ length: lines }, (_, line) => line + lines * Math.ceil((first - line) / lines));
}
