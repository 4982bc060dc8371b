/** Weights of a front's objectives, and the sets that win under them. */

import type { FrontObjective, FrontRow } from "../server/types";

export type Goal = Pick<FrontObjective, "name" | "direction">;
type Valued = Pick<FrontRow, "objectives">;

/** The objectives of each set in shares of their ranges on the front: 0 is the worst, 1 the best, 1 where all are equal. As the API scales them. */
export function shares(rows: readonly Valued[], goals: readonly Goal[]): number[][] {
  const compared = rows.map(({ objectives }) => goals.map(({ name, direction }) => (direction === "minimise" ? -1 : 1) * (objectives[name] ?? NaN)));
  const ends = goals.map((_, column) => compared.reduce<[number, number]>(([low, high], row) => [Math.min(low, row[column] as number), Math.max(high, row[column] as number)], [Infinity, -Infinity]));
  return compared.map((row) => row.map((value, column) => {
    const [low, high] = ends[column] as [number, number];
    return high > low ? (value - low) / (high - low) : 1;
  }));
}

/** Weights of sum 1; equal ones if all are 0. */
export function normalised(weights: readonly number[]): number[] {
  const sum = weights.reduce((total, weight) => total + weight, 0);
  return weights.map((weight) => (sum > 0 ? weight / sum : 1 / weights.length));
}

/** The weighted sum of each set, from 0 to 1. */
export function sums(scaled: readonly (readonly number[])[], weights: readonly number[]): number[] {
  const parts = normalised(weights);
  return scaled.map((row) => row.reduce((sum, share, column) => sum + share * (parts[column] ?? 0), 0));
}

/** Sums that differ by less are equal: the first of the front wins. */
const EQUAL = 1e-9;

/** The places of the few sets with the largest sums, the winner first. */
export function leading(totals: readonly number[], most: number): number[] {
  const first: number[] = [];
  totals.forEach((total, place) => {
    const worse = first.findIndex((other) => total > (totals[other] as number) + EQUAL);
    if (worse >= 0) first.splice(worse, 0, place);
    else if (first.length < most) first.push(place);
    if (first.length > most) first.pop();
  });
  return first;
}

/** Weights as the API writes them, `comfort=2,gap=1`; objectives that are not named have weight 1. Null without any, and if all are 0. */
export function weightsOf(text: string | undefined, goals: readonly Pick<Goal, "name">[]): number[] | null {
  if (!text) return null;
  const given = new Map(text.split(",").map((part): [string, number] => {
    const at = part.lastIndexOf("=");
    return [part.slice(0, at), Number(part.slice(at + 1))];
  }));
  const weights = goals.map(({ name }) => {
    const weight = given.get(name) ?? 1;
    return weight >= 0 ? weight : 1;
  });
  return weights.some((weight) => weight > 0) ? weights : null;
}

export function weightsText(weights: readonly number[], goals: readonly Pick<Goal, "name">[]): string {
  return goals.map(({ name }, place) => `${name}=${Number((weights[place] ?? 1).toFixed(4))}`).join(",");
}

/** The problem's scenario, S1, of a campaign's: S1, or S1@eu in the vehicle of a variant. */
export function baseOf(scenario: string): string {
  return scenario.split("@")[0] ?? scenario;
}

/** Weights with one more or less of one objective, the others in their proportions. */
export function moved(weights: readonly number[], which: number, by: number): number[] {
  const parts = normalised(weights);
  const now = Math.min(1, Math.max(0, (parts[which] ?? 0) + by));
  const rest = 1 - (parts[which] ?? 0);
  return parts.map((part, place) => (place === which ? now : rest > 0 ? (part / rest) * (1 - now) : (1 - now) / (parts.length - 1)));
}
