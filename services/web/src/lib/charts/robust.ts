/** Figure 12: how far each of the best sets bears other vehicles. */

import type { BoxTrial, RobustnessRow } from "../server/types";

export interface Piece {
  from: number;
  to: number;
  /** The largest deviation in any scenario; null if a vehicle has no result. */
  worst: number | null;
  looks: "same" | "changes" | "fails";
  box: number;
}

/** The largest deviation over all scenarios and vehicles of a box; null if one has no result. */
export function worst(trial: BoxTrial): number | null {
  const deviations = Object.values(trial.deviations);
  return deviations.length === 0 || deviations.some((entry) => entry === null) ? null : Math.max(...(deviations as number[]));
}

/** The bar of a set, from 0 to the widest box that was tried, a piece for each box. */
export function pieces(row: RobustnessRow): Piece[] {
  let from = 0;
  return [...row.trials]
    .sort((a, b) => a.radius - b.radius)
    .map((trial) => {
      const largest = worst(trial);
      const piece: Piece = { from, to: trial.radius, worst: largest, box: trial.box, looks: !trial.holds ? "fails" : largest === 0 ? "same" : "changes" };
      from = trial.radius;
      return piece;
    });
}

/** What the condition of a study was, in words. */
export function condition(settings: Readonly<Record<string, unknown>>): string {
  const eta = String(settings["eta"] ?? 1);
  if (settings["condition"] === "mean") return `the mean relative change over the vehicles below ${eta}`;
  return `no score changes by more than ${eta}`;
}
