/** Points of a table on two axes. */

/** At most `most` rows, evenly over their order: enough to see a shape, few enough for a frame. */
export function thinned(rows: Uint32Array, most: number): Uint32Array {
  if (rows.length <= most) return rows;
  const every = rows.length / most;
  return Uint32Array.from({ length: most }, (_, place) => rows[Math.floor(place * every)] ?? 0);
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

/** A Gaussian of this width fits evenly spread points, in shares of an axis (Scott's rule). */
const SPREAD = 0.29;
/** The least sum of weights of a field: below it no point is near. */
const LEAST = 0.3;

/** Means of the values of points nearby, in the fields of a square grid, line by line; null far from any point. `across` and `up` are shares of the axes. */
export function smoothed(across: readonly number[], up: readonly number[], values: readonly number[], size: number): (number | null)[] {
  const width = 2 * (SPREAD * Math.max(1, values.length) ** (-1 / 6)) ** 2;
  return Array.from({ length: size * size }, (_, place) => {
    const [x, y] = [((place % size) + 0.5) / size, (Math.floor(place / size) + 0.5) / size];
    let [sum, weights] = [0, 0];
    values.forEach((value, point) => {
      const weight = Math.exp(-(((across[point] ?? 0) - x) ** 2 + ((up[point] ?? 0) - y) ** 2) / width);
      [sum, weights] = [sum + weight * value, weights + weight];
    });
    return weights < LEAST ? null : sum / weights;
  });
}
