/** The sets of a front as a table, what they are made of, and what marks them. */

import { COLOURS, SERIES } from "../charts/palette";
import { EMPTY, type Column, type Table } from "../server/columns";
import type { FrontRow } from "../server/types";

type Value = number | string | boolean | null | undefined;

/** The names of the columns that hold what a front is searched for. */
export const objectiveColumn = (name: string): string => `objective_${name}`;

/** Fields of a set whose values have a column each, by what its name begins with. */
const SPREAD: Readonly<Record<string, string>> = { objectives: "objective_", uncertainty: "objective_", constraints: "constraint_", scores: "score_", values: "value_", answers: "answer_" };

/** Fields that no column has as they are. */
const APART = ["parameters", "weighted", "weights"];

/** Sets as a table with the columns of its files, without the weights under which a set wins, and `further` ones. */
export function tableOf(rows: readonly FrontRow[], parameters: readonly { name: string; column: string }[], further: Readonly<Record<string, readonly Value[]>> = {}): Table {
  const cells = rows.map((row): Record<string, Value> => {
    const fields = Object.entries(row).filter(([field]) => !APART.includes(field)).flatMap(([field, value]: [string, unknown]): [string, Value][] => {
      if (Array.isArray(value)) return [[field, value.join(" ") || null]];
      return typeof value === "object" && value !== null ? Object.entries(value as Record<string, Value>).map(([key, each]) => [`${SPREAD[field] ?? ""}${key}`, each]) : [[field, value as Value]];
    });
    return Object.fromEntries([...fields, ...parameters.map(({ name, column }): [string, Value] => [column, row.parameters[name]])]);
  });
  const columns = Object.keys(cells[0] ?? {}).map((name) => [name, cells.map((row) => row[name])]);
  return withColumns({ ...EMPTY, length: rows.length }, { ...Object.fromEntries(columns), ...further });
}

/** A table with further columns, for the page alone. */
export function withColumns(table: Table, further: Readonly<Record<string, readonly Value[]>>): Table {
  const columns = Object.fromEntries(Object.entries(further).map(([name, values]) => [name, columnOf(name, values)]));
  return { length: table.length, names: [...table.names, ...Object.keys(columns)], columns: { ...table.columns, ...columns } };
}

function columnOf(name: string, values: readonly Value[]): Column {
  if (values.every((value) => typeof value === "number" || value === null || value === undefined)) {
    return { kind: "number", name, values: Float64Array.from(values, (value) => (typeof value === "number" ? value : NaN)) };
  }
  const words = new Map<string, number>();
  const codes = Int32Array.from(values, (value) => {
    if (value === null || value === undefined) return -1;
    const code = words.get(String(value)) ?? words.size;
    words.set(String(value), code);
    return code;
  });
  return { kind: "text", name, words: [...words.keys()], codes };
}

/** How sets are answered, the least certain first. */
export const ANSWERS = ["reused", "repeated", "stored", "confirmed", "simulated"] as const;
export type Answer = (typeof ANSWERS)[number];

/** What an answer of a set is, in a word and a sentence, and its colour. */
export const ANSWER: Readonly<Record<Answer, { word: string; meaning: string; colour: string }>> = {
  reused: { word: "copied", meaning: "the score of a stored set that differs only where the influence map says that it does not matter", colour: COLOURS.reused },
  repeated: { word: "repeated", meaning: "the stored result of this very set", colour: COLOURS.repeated },
  stored: { word: "stored", meaning: "a run of this very set by another campaign", colour: SERIES[7] ?? "" },
  confirmed: { word: "confirmed", meaning: "copied or predicted at first, then simulated", colour: COLOURS.predicted },
  simulated: { word: "simulated", meaning: "a run of this very set", colour: COLOURS.simulated },
};

/** What a set is made of: its kinds of answers with the scenarios of each, the least certain first. */
export function madeOf(answers: Readonly<Record<string, string>> | undefined): { kind: Answer; scenarios: string[] }[] {
  const given = Object.entries(answers ?? {});
  return ANSWERS.map((kind) => ({ kind, scenarios: given.filter(([, answer]) => answer === kind).map(([scenario]) => scenario) })).filter(({ scenarios }) => scenarios.length > 0);
}

/** The kind of a whole set: its least certain answer. */
export function kindOf(answers: Readonly<Record<string, string>> | undefined): Answer {
  return madeOf(answers)[0]?.kind ?? "simulated";
}

export function madeOfText(answers: Readonly<Record<string, string>> | undefined): string {
  return madeOf(answers).map(({ kind, scenarios }) => `${scenarios.length} ${ANSWER[kind].word}`).join(", ");
}

/** Whether a campaign has a front worth a view: more than one objective. */
export function hasFront(spec: Readonly<Record<string, unknown>>): boolean {
  return Array.isArray(spec["objectives"]) && spec["objectives"].length > 1;
}

/** The words that mark sets, by their places: knee, best in an objective. */
export function marksOf(rows: readonly Pick<FrontRow, "knee" | "best_in">[]): Map<number, string[]> {
  const marks = new Map<number, string[]>();
  rows.forEach(({ knee, best_in: best }, place) => {
    const words = [...(knee ? ["knee"] : []), ...best.map((name) => `best ${name}`)];
    if (words.length > 0) marks.set(place, words);
  });
  return marks;
}

/** The two sets that a view compares, by their places. */
export interface Pair {
  current: number | null;
  other: number | null;
}

/** The pair that the address names by ranks. If it names none, the winner is compared with the knee; a set is never compared with itself. The baseline is no place. */
export function pairOf(rows: readonly Pick<FrontRow, "rank" | "knee">[], row: string | undefined, other: string | undefined, winner: number | null): Pair {
  const place = (rank: string | undefined): number | null => {
    const at = rank === undefined ? -1 : rows.findIndex((entry) => entry.rank === Number(rank));
    return at < 0 ? null : at;
  };
  if (rows.length === 0) return { current: null, other: null };
  const knee = rows.findIndex((entry) => entry.knee);
  const given = place(other);
  const current = place(row) ?? [winner, 0, rows.length - 1].find((entry) => entry !== null && entry !== given) ?? 0;
  const beside = [given, knee < 0 ? null : knee, 0, rows.length - 1].find((entry) => entry !== null && entry !== current);
  return { current, other: other === "baseline" ? null : (beside ?? null) };
}

/** The next set along an axis, so that the arrow keys walk over the front; the first or the last without one. */
export function neighbour(along: Float64Array, kept: Uint32Array, current: number | null, step: number): number | null {
  const order = kept.slice().sort((a, b) => (along[a] as number) - (along[b] as number) || a - b);
  if (order.length === 0) return null;
  const at = current === null ? -1 : order.indexOf(current);
  const to = at < 0 ? (step > 0 ? 0 : order.length - 1) : Math.min(order.length - 1, Math.max(0, at + step));
  return order[to] ?? null;
}

/** The range of an axis: that of the front and the baseline, and of the dominated sets up to a part of it, for a failed run must not press the front into a corner; all of them around a single value. */
export function rangeOf(front: readonly number[], baseline: number | undefined, others: ArrayLike<number>, all: boolean): [number, number] {
  const near = [...front, ...(baseline === undefined ? [] : [baseline])];
  const [low, high] = [Math.min(...near), Math.max(...near)];
  const room = high - low || Math.abs(high) || 1;
  let [least, most] = [low, high];
  for (let at = 0; at < others.length; at++) {
    const value = others[at] as number;
    if (Number.isNaN(value)) continue;
    const within = all || low === high ? value : Math.min(high + 0.4 * room, Math.max(low - 0.4 * room, value));
    if (within < least) least = within;
    if (within > most) most = within;
  }
  return [least, most];
}
