/** Axes and colours of parallel coordinates, for parameters of every kind and scores of every scale. */

import { extent, type Table } from "../server/columns";
import type { Scale, SearchedParameter } from "../server/types";
import { unitText } from "../text/format";
import type { Axis } from "./polylines";

/** A parameter as a campaign's setup describes it; bounds of a choice are positions in `choices`, `column` names it in tables. */
export type Ranged = Pick<SearchedParameter, "name" | "column" | "unit" | "lower" | "upper"> & Partial<Pick<SearchedParameter, "kind" | "choices" | "description">>;

/** A column whose lines are coloured, from its worst value to its best. */
export interface Colouring {
  name: string;
  worst: number;
  best: number;
}

/** A quantity with its unit; 1 and points are not worth a word. */
export function titled(name: string, unit: string | null | undefined): string {
  return unit && unit !== "1" && unit !== "points" ? `${name} / ${unitText(unit)}` : name;
}

/** The parameter that a column holds. */
export function parameterOf<T extends { column: string }>(column: string, parameters: readonly T[]): T | undefined {
  return parameters.find((parameter) => parameter.column === column);
}

/** An axis for each column of a parameter. Texts stand in the order of the parameter's choices, then of the alphabet. */
export function parameterAxes(table: Table, parameters: readonly Ranged[]): Axis[] {
  return table.names.flatMap((name): Axis[] => {
    const [column, known] = [table.columns[name], parameterOf(name, parameters)];
    if (column === undefined || known === undefined) return [];
    const axis = { name, title: titled(known.name, known.unit), parameter: known.name, ...(known.description ? { meaning: known.description } : {}) };
    if (column.kind === "number") return [{ ...axis, lower: known.lower, upper: known.upper }];
    const listed = known.choices ?? [];
    const choices = [...listed, ...column.words.filter((word) => !listed.includes(word)).sort()];
    return [{ ...axis, lower: 0, upper: Math.max(1, choices.length - 1), choices }];
  });
}

/** The axis of a score: from the least to the largest value; its usual range if there is only one. */
export function scoreAxis(table: Table, name: string, scale: Scale): Axis {
  const [low, high] = extent(table, name) ?? [scale.lower, scale.upper];
  const { lower, upper } = low < high ? { lower: low, upper: high } : scale;
  return { name, title: titled(name, scale.unit), lower, upper };
}

export function isMinimised(scale: Pick<Scale, "direction">): boolean {
  return scale.direction === "minimise";
}

/** The colours of a column of scores over a range of them: by default the scale's usual one. */
export function colouring(name: string, scale: Scale, range: readonly [number, number] = [scale.lower, scale.upper]): Colouring {
  const [low, high] = range;
  return isMinimised(scale) ? { name, worst: high, best: low } : { name, worst: low, best: high };
}

/** The values of a column along its axis: texts by their place among the choices, NaN if there is none. */
export function positions(table: Table, axis: Pick<Axis, "name" | "choices">): Float64Array {
  const column = table.columns[axis.name];
  if (column === undefined) return new Float64Array(0);
  if (column.kind === "number") return column.values;
  const places = column.words.map((word) => axis.choices?.indexOf(word) ?? -1).map((place) => (place < 0 ? Number.NaN : place));
  const values = new Float64Array(column.codes.length);
  for (let row = 0; row < values.length; row++) values[row] = places[column.codes[row] as number] ?? Number.NaN;
  return values;
}

/** Whether there are several values. */
export function isVarying(values: Float64Array): boolean {
  const first = values.find((value) => !Number.isNaN(value));
  return values.some((value) => value !== first && !Number.isNaN(value));
}

/** The choices within a range of their positions. */
export function chosen(axis: Pick<Axis, "choices">, [low, high]: readonly [number, number]): string[] {
  return (axis.choices ?? []).filter((_, place) => place >= low && place <= high);
}

const MOST_TICKS = 12;

/** The choices that an axis names, with their places: not all, if there are many. */
export function marks(choices: readonly string[]): [number, string][] {
  const every = Math.ceil(choices.length / MOST_TICKS);
  return choices.map((word, place): [number, string] => [place, word.length > 12 ? `${word.slice(0, 11)}…` : word]).filter(([place]) => place % every === 0);
}
