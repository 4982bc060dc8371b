/** A table on two axes as fields of a grid: how many rows lie in each, and what they are worth. Fields without a row have no value. */

import type { Axis } from "./polylines";

type Ends = Pick<Axis, "lower" | "upper" | "choices">;

/** A field with rows: its place in the grid, and the mean and the best of their values. */
export interface Field {
  column: number;
  line: number;
  rows: number;
  mean: number;
  best: number;
  /** From the least to the largest value of its rows on each axis: the rows of the next field begin at the field's end. */
  across: [number, number];
  up: [number, number];
}

export interface Grid {
  /** Ends of the columns and lines, one more than there are. */
  x: number[];
  y: number[];
  fields: Field[];
  /** Rows without a value on an axis, or without a value at all. */
  left: number;
}

const PARTS = 12;

/** The ends of equal parts of an axis; choices have a part each. */
export function parts(axis: Ends, most = PARTS): number[] {
  if (axis.choices) return Array.from({ length: axis.choices.length + 1 }, (_, place) => place - 0.5);
  const wide = (axis.upper - axis.lower || 1) / most;
  return Array.from({ length: most + 1 }, (_, place) => (place === most && axis.upper > axis.lower ? axis.upper : axis.lower + place * wide));
}

/** The part that holds a value; the last part has its upper end, values beyond the axis lie in the part at its end. */
function partOf(ends: readonly number[], value: number): number {
  const [first = 0, last = 1] = [ends[0], ends.at(-1)];
  const place = Math.floor(((value - first) / (last - first)) * (ends.length - 1));
  return Math.min(ends.length - 2, Math.max(0, place));
}

/** The rows in a grid over both axes. `sign`: 1 if more is better, else -1. */
export function gridOf(rows: Uint32Array, xs: Float64Array, ys: Float64Array, values: Float64Array, across: Ends, up: Ends, sign: number): Grid {
  const [x, y] = [parts(across), parts(up)];
  const sums = new Map<number, Pick<Field, "rows" | "best" | "across" | "up"> & { sum: number }>();
  let left = 0;
  rows.forEach((row) => {
    const [a, b, value] = [xs[row] ?? NaN, ys[row] ?? NaN, values[row] ?? NaN];
    if (Number.isNaN(a) || Number.isNaN(b) || Number.isNaN(value)) {
      left += 1;
      return;
    }
    const place = partOf(y, b) * (x.length - 1) + partOf(x, a);
    const known = sums.get(place);
    if (known === undefined) sums.set(place, { rows: 1, sum: value, best: value, across: [a, a], up: [b, b] });
    else {
      known.rows += 1;
      known.sum += value;
      if (sign * value > sign * known.best) known.best = value;
      known.across = [Math.min(known.across[0], a), Math.max(known.across[1], a)];
      known.up = [Math.min(known.up[0], b), Math.max(known.up[1], b)];
    }
  });
  const fields = [...sums].map(([place, { sum, ...field }]): Field => ({ ...field, column: place % (x.length - 1), line: Math.floor(place / (x.length - 1)), mean: sum / field.rows }));
  return { x, y, fields, left };
}
