/** Where everything is at a moment of a replay. Metres, seconds, radians. */

import type { ReplayVehicle } from "../server/types";

export interface Pose {
  x: number;
  y: number;
  heading: number;
}

/** The index of the last of ascending `times` that is not after `moment`; -1 before the first. */
export function lastBefore(times: readonly number[], moment: number): number {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((times[middle] as number) <= moment + 1e-9) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The index of the place nearest to a moment; null without places. */
export function nearestTo(places: readonly number[], moment: number): number | null {
  if (places.length === 0) return null;
  const before = Math.max(0, lastBefore(places, moment));
  const next = places[before + 1];
  return next !== undefined && next - moment < moment - (places[before] as number) ? before + 1 : before;
}

/** A series at a moment, between its values as between points of a line; its first and last value beyond its ends. */
export function at(times: readonly number[], values: readonly number[], moment: number): number {
  const before = lastBefore(times, moment);
  if (before < 0) return values[0] ?? Number.NaN;
  const value = values[before] ?? Number.NaN;
  const other = values[before + 1];
  if (other === undefined) return value;
  const from = times[before] as number;
  const share = (moment - from) / ((times[before + 1] as number) - from);
  return value + Math.max(0, share) * (other - value);
}

export function poseAt(times: readonly number[], { x_m, y_m, heading_rad }: Pick<ReplayVehicle, "x_m" | "y_m" | "heading_rad">, moment: number): Pose {
  return { x: at(times, x_m, moment), y: at(times, y_m, moment), heading: headingAt(times, heading_rad, moment) };
}

/** A heading at a moment or place, by the shorter turn: headings jump by a whole turn. */
export function headingAt(times: readonly number[], headings: readonly number[], moment: number): number {
  const before = lastBefore(times, moment);
  const [heading, next] = [headings[before], headings[before + 1]];
  if (heading === undefined || next === undefined) return at(times, headings, moment);
  const turn = next - heading - 2 * Math.PI * Math.round((next - heading) / (2 * Math.PI));
  const from = times[before] as number;
  return heading + (turn * (moment - from)) / ((times[before + 1] as number) - from);
}

/** The plan that is followed at a moment: the newest that was made by then. */
export function planAt<T extends { made_at_s: number }>(plans: readonly T[], moment: number): T | null {
  const before = lastBefore(plans.map((plan) => plan.made_at_s), moment);
  return plans[before] ?? null;
}

/** From the world to a view that looks along the ego's way: `ego` lies at `centre`, ahead is to the right, left is up. */
export function camera(ego: Pose, scale: number, centre: readonly [number, number], turn: number): (x: number, y: number) => [number, number] {
  const [cos, sin] = [Math.cos(-turn), Math.sin(-turn)];
  return (x, y) => {
    const [dx, dy] = [x - ego.x, y - ego.y];
    return [centre[0] + scale * (dx * cos - dy * sin), centre[1] - scale * (dx * sin + dy * cos)];
  };
}

/** Round numbers between two ends. `about`: their number, roughly. */
export function ticks(low: number, high: number, about: number): number[] {
  if (!(high > low)) return [low];
  const rough = (high - low) / about;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = ([1, 2, 5, 10].find((factor) => factor * power >= rough) ?? 10) * power;
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, index) => Number(((first + index) * step).toPrecision(12)));
}
