/** Bars of importance, and how far they can be trusted. */

import { count, number } from "../text/format";
import type { ImportanceAnswer } from "../server/types";

export interface Bar {
  name: string;
  value: number;
  deviation: number;
  /** Of the longest bar; 0 if the value is not above 0. */
  share: number;
}

/** Bars in order, the largest first. */
export function bars(values: readonly Omit<Bar, "share">[]): Bar[] {
  const most = Math.max(1e-12, ...values.map((entry) => entry.value));
  return [...values].sort((a, b) => b.value - a.value).map((entry) => ({ ...entry, share: Math.max(0, entry.value / most) }));
}

const LITTLE = 0.3;

/** What a forest that predicts so well lets its importances mean. */
export function judgement({ items, sets, held_out: judged, r2 }: Pick<ImportanceAnswer, "items" | "sets" | "held_out" | "r2">): string {
  if (items.length === 0 || r2 === null) return `No importance: ${count(sets)} sets with values of their own are too few, or their values are all the same.`;
  const base = `${count(sets)} sets, ${count(judged ?? 0)} of them held out: R² ${number(r2, 2)}.`;
  return r2 < LITTLE ? `${base} The forest explains little of these sets: the bars mean little, too.` : base;
}
