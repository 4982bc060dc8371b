/** Histograms of differences between scores, as a validation counts them. */

import type { Scale, ValidationRow } from "../server/types";

/** Bars on each side at most; the outermost holds all beyond. */
const MOST_BARS = 101;

interface Bars {
  /** Middles of the bars, in units of the score. */
  places: number[];
  /** Whether a bar's differences are beyond the tolerance. */
  wrong: boolean[];
  /** By row, then by bar. */
  counts: number[][];
  /** Whether an outermost bar holds differences beyond the scale's span. */
  beyond: boolean;
}

export function barsOf(rows: readonly Pick<ValidationRow, "histogram" | "histogram_step">[], scale: Pick<Scale, "lower" | "upper" | "tolerance">): Bars {
  const step = rows[0]?.histogram_step ?? 1;
  const span = scale.upper - scale.lower;
  const usual = Math.min(MOST_BARS, Math.round(span / step));
  const largest = rows.reduce((most, row) => Object.keys(row.histogram).reduce((so, bar) => Math.max(so, Math.abs(Number(bar))), most), usual);
  const last = Math.min(MOST_BARS, largest);
  const counts = rows.map((row) => {
    const counted = new Array<number>(2 * last + 1).fill(0);
    for (const [bar, count] of Object.entries(row.histogram)) {
      const place = Math.max(-last, Math.min(last, Number(bar))) + last;
      counted[place] = (counted[place] ?? 0) + count;
    }
    return counted;
  });
  const places = Array.from({ length: 2 * last + 1 }, (_, index) => (index - last) * step);
  return { places, wrong: places.map((place) => Math.abs(place) > scale.tolerance * (1 + 1e-9)), counts, beyond: (largest - 0.5) * step >= span * (1 - 1e-9) };
}
