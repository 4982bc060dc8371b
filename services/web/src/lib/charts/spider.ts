/** Figure 9: spokes are parameters, from their lower bound at the hub to their upper bound at the rim. */

import type { InfluenceRow } from "../server/types";

export const HUB = 0.2;

/** The influential part of a parameter's range, from 0 to 1; null if nothing is. */
export function segment(row: InfluenceRow): [number, number] | null {
  if (!row.influential) return null;
  if (row.space_lower === null || row.space_upper === null || row.space_upper === row.space_lower) return [0, 1];
  const size = row.space_upper - row.space_lower;
  return [row.lower === null ? 0 : (row.lower - row.space_lower) / size, row.upper === null ? 1 : (row.upper - row.space_lower) / size];
}

/** The path of a piece of a spoke: between two shares of the range, and two angles (radians, clockwise from the top). */
export function piece(from: number, to: number, start: number, end: number, radius: number): string {
  const inner = (HUB + (1 - HUB) * from) * radius;
  const outer = (HUB + (1 - HUB) * to) * radius;
  const point = (length: number, angle: number): string => `${(length * Math.sin(angle)).toFixed(2)} ${(-length * Math.cos(angle)).toFixed(2)}`;
  return `M${point(inner, start)}A${inner.toFixed(2)} ${inner.toFixed(2)} 0 0 1 ${point(inner, end)}L${point(outer, end)}A${outer.toFixed(2)} ${outer.toFixed(2)} 0 0 0 ${point(outer, start)}Z`;
}

/** The largest s_rel of all: the one scale of all scenarios. */
export function largest(rows: readonly InfluenceRow[]): number {
  return Math.max(1e-9, ...rows.flatMap((row) => row.s_rel_intervals ?? []).map((value) => value ?? 0));
}
