/** Headings of the grids. */

import { parameterOf, titled, type Ranged } from "../charts/axes";
import type { Table } from "../server/columns";
import { spaced, yesNo } from "./format";

export interface Heading {
  name: string;
  title: string;
  hint?: string;
  width: number;
  numeric?: boolean;
  /** Which end is the best: the first click on the heading puts it first. */
  best?: "high" | "low";
  /** Added to its numbers: tables count from 0, people from 1. */
  add?: number;
  /** Its words for readers. */
  say?: (word: string) => string;
  /** Its numbers are shares. */
  share?: boolean;
}

const LETTER = 8;
const wide = (text: string, least: number): number => Math.max(least, 20 + LETTER * text.length);

/** The columns of parameters in a table. */
export function parameterHeadings(table: Table, parameters: readonly Ranged[]): Heading[] {
  return table.names.flatMap((name): Heading[] => {
    const known = parameterOf(name, parameters);
    if (known === undefined) return [];
    const hint = [titled(known.name, known.unit), known.description].filter(Boolean).join(": ");
    return [{ name, title: known.name, hint, width: wide(known.name, 72), numeric: table.columns[name]?.kind === "number" }];
  });
}

/** The columns of amounts by scenario or goal, as `score_S1`, with a hint for each. */
export function amountHeadings(table: Table, prefix: string, hint: (key: string) => string, more: Partial<Heading> = {}): Heading[] {
  const keys = table.names.filter((name) => name.startsWith(prefix)).map((name) => name.slice(prefix.length));
  return keys.map((key) => ({ name: prefix + key, title: key, width: wide(key, 84), numeric: true, hint: hint(key), ...more }));
}

/** All other columns of a table, at its end. */
export function furtherHeadings(table: Table, usual: readonly Heading[], hidden: readonly string[]): Heading[] {
  const known = new Set([...hidden, ...usual.map(({ name }) => name)]);
  return table.names.filter((name) => !known.has(name)).map((name) => ({ name, title: spaced(name), width: 96, numeric: table.columns[name]?.kind === "number", say: yesNo }));
}

export const ITERATION: Heading = { name: "iteration", title: "iter.", width: 62, numeric: true, add: 1, hint: "Iteration, counted from 1; files and the API count from 0" };
