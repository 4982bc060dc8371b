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
