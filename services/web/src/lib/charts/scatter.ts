/** Points of a table on two axes, and the best of them along one. */

import type { Axis } from "./polylines";

/** At most `most` rows, evenly over their order: enough to see a shape, few enough for a frame. */
export function thinned(rows: Uint32Array, most: number): Uint32Array {
  if (rows.length <= most) return rows;
  const every = rows.length / most;
  return Uint32Array.from({ length: most }, (_, place) => rows[Math.floor(place * every)] ?? 0);
}

/** The best of `ys` in each of the equal parts of the x axis, as points at the middle of their part; parts without a value are left out. `sign`: 1 if more is better, else -1. */
export function envelope(rows: Uint32Array, xs: Float64Array, ys: Float64Array, axis: Pick<Axis, "lower" | "upper" | "choices">, sign: number, parts = 20): [number, number][] {
  const many = axis.choices ? axis.choices.length : parts;
  const wide = axis.choices ? 1 : (axis.upper - axis.lower) / many || 1;
  const start = axis.choices ? -0.5 : axis.lower;
  const best: (number | undefined)[] = Array.from({ length: many });
  rows.forEach((row) => {
    const [x, y] = [xs[row] ?? NaN, ys[row] ?? NaN];
    if (Number.isNaN(x) || Number.isNaN(y)) return;
    const part = Math.min(many - 1, Math.max(0, Math.floor((x - start) / wide)));
    const known = best[part];
    if (known === undefined || sign * y > sign * known) best[part] = y;
  });
  return best.flatMap((y, part): [number, number][] => (y === undefined ? [] : [[start + (part + 0.5) * wide, y]]));
}

/** The row whose point lies nearest to a place in pixels, within a reach; null without one. */
export function nearest(rows: Uint32Array, px: (row: number) => number, py: (row: number) => number, x: number, y: number, reach: number): number | null {
  let [close, at]: [number, number | null] = [reach * reach, null];
  rows.forEach((row) => {
    const distance = (px(row) - x) ** 2 + (py(row) - y) ** 2;
    if (distance <= close) [close, at] = [distance, row];
  });
  return at;
}
