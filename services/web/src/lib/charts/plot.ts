/** Where the lines and points of a chart lie: scales, paths, and which points are drawn, in pixels from the upper left corner. */

import type { Sheet } from "../server/columns";
import { number } from "../text/format";
import { nearestTo } from "./geometry";

export interface Series {
  name: string;
  values: readonly (number | null)[];
  colour: string;
  dash?: string | undefined;
  /** Its own places, if they differ from the chart's. */
  x?: readonly number[];
  /** Series of one group have one entry in the legend. */
  group?: string;
  /** Holds each value until the next place. */
  steps?: boolean;
  /** Offset of its line in pixels, so that lines of equal value do not hide each other. */
  shift?: number;
}

export interface Frame {
  width: number;
  height: number;
  left: number;
  right: number;
  top: number;
  bottom: number;
  x: readonly [number, number];
  y: readonly [number, number];
}

interface Scales {
  px: (value: number) => number;
  py: (value: number) => number;
  /** From pixels to values. */
  x: (pixel: number) => number;
  y: (pixel: number) => number;
}

/** Between values and pixels. */
export function scales(frame: Frame): Scales {
  const [[x0, x1], [y0, y1]] = [frame.x, frame.y];
  const across = (frame.width - frame.left - frame.right) / (x1 - x0 || 1);
  const up = (frame.height - frame.top - frame.bottom) / (y1 - y0 || 1);
  return {
    px: (value) => frame.left + (value - x0) * across,
    py: (value) => frame.height - frame.bottom - (value - y0) * up,
    x: (pixel) => x0 + (pixel - frame.left) / across,
    y: (pixel) => y0 + (frame.height - frame.bottom - pixel) / up,
  };
}

/** From the smallest to the largest of all known values, with a share of their span beyond both. */
export function reach(lists: readonly (readonly (number | null)[])[], beyond = 0.06): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const values of lists) {
    for (const value of values) {
      if (value === null || Number.isNaN(value)) continue;
      [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
  }
  if (low > high) return [0, 1];
  const margin = low === high ? 0.5 : (high - low) * beyond; // a single value stands in the middle
  return [low - margin, high + margin];
}

/** A mark of an axis, which is a round number, with all of its digits. */
export const marked = (tick: number): string => number(tick, 9);

/** Pixels that the marks of the axis upwards take. */
export const room = (marks: readonly string[]): number => Math.min(160, Math.max(50, 24 + 6.3 * Math.max(0, ...marks.map(({ length }) => length))));

/** Pixels to both sides of a single value, which would not be seen otherwise. */
const MARK = 7;

/** A line as the `d` of an SVG path. */
export function outline(line: Series, x: readonly number[], frame: Frame): string {
  const { px, py } = scales(frame);
  const places = line.x ?? x;
  const points: [string, string][] = [];
  line.values.forEach((value, index) => {
    if (value === null || Number.isNaN(value)) return;
    const [at, height] = [px(places[index] ?? 0).toFixed(1), (py(value) + (line.shift ?? 0)).toFixed(1)];
    const before = points.at(-1);
    if (line.steps && before !== undefined) points.push([at, before[1]]);
    points.push([at, height]);
  });
  const [first] = points;
  if (first !== undefined && points.length === 1) return `M${[-MARK, MARK].map((by) => `${(Number(first[0]) + by).toFixed(1)} ${first[1]}`).join("L")}`;
  return points.length === 0 ? "" : `M${points.map((point) => point.join(" ")).join("L")}`;
}

/** The value of a line near a moment; null outside of places of its own. */
export function valueNear(line: Series, x: readonly number[], moment: number): number | null {
  const at = nearestTo(line.x ?? x, moment);
  const isOutside = line.x !== undefined && (moment < (line.x[0] ?? 0) || moment > (line.x.at(-1) ?? 0));
  return at === null || isOutside ? null : (line.values[at] ?? null);
}

/** The numbers of a chart: a row for each place, or for each value of each line if lines have places of their own. */
export function numbersOf(series: readonly Series[], x: readonly number[], xTitle: string, yTitle: string): Sheet {
  if (series.every((line) => line.x === undefined)) return { head: [xTitle, ...series.map((line) => line.name)], rows: x.map((value, at) => [value, ...series.map((line) => line.values[at] ?? null)]) };
  return { head: ["line", xTitle, yTitle], rows: series.flatMap((line) => line.values.map((value, at) => [line.name, (line.x ?? x)[at] ?? null, value])) };
}

/** What the legend lists: each group once. */
export function legend(series: readonly Series[]): Series[] {
  return [...Map.groupBy(series, (line) => line.group ?? line.name).values()].flatMap(([first]) => first ?? []);
}

/** Sizes a canvas to a width and height in CSS pixels, sharp on dense screens, and returns its empty drawing context. */
export function prepared(canvas: HTMLCanvasElement, width: number, height: number): CanvasRenderingContext2D | null {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  canvas.width = Math.round(width * ratio);
  canvas.height = height * ratio;
  canvas.parentElement?.style.setProperty("--drawn", `${width}px`); // cards are wider on paper
  const pen = canvas.getContext("2d");
  pen?.scale(ratio, ratio);
  return pen;
}

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

/** How densely values lie in the fields of a range (Gaussians, Silverman's rule). */
export function density(values: readonly number[], low: number, high: number, fields: number): number[] {
  const [sorted, count] = [[...values].sort((a, b) => a - b), Math.max(1, values.length)];
  const quantile = (share: number): number => sorted[Math.round(share * (count - 1))] ?? 0;
  const mean = values.reduce((sum, value) => sum + value, 0) / count;
  const deviation = Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / count);
  const spread = Math.min(deviation, (quantile(0.75) - quantile(0.25)) / 1.34 || deviation);
  const width = Math.max(0.9 * spread * count ** -0.2, (high - low) / fields / 2); // a single value is seen, too
  return Array.from({ length: fields }, (_, place) => {
    const at = low + ((place + 0.5) * (high - low)) / fields;
    return values.reduce((sum, value) => sum + Math.exp(-(((value - at) / width) ** 2) / 2), 0) / (width * count);
  });
}

/** The width of likeness, and of the mean along a slice, in shares of the axes. */
const [ALIKE, ALONG] = [0.2, 0.08];

/** How like the first row each row is in some parameters, 1 if equal: a Gaussian of the root mean square of the distances. */
export function likeness(others: readonly { shares: readonly number[]; isChoice: boolean }[], rows: number): number[] {
  return Array.from({ length: rows }, (_, row) => {
    const squares = others.reduce((sum, { shares, isChoice }) => sum + (isChoice ? Number(shares[row] !== shares[0]) : ((shares[row] ?? 0) - (shares[0] ?? 0)) ** 2), 0);
    return Math.exp(-squares / (others.length || 1) / (2 * ALIKE ** 2));
  });
}

/** Means of values along an axis from 0 to 1, weighted by nearness; null where no set is near. */
export function slice(along: readonly number[], values: readonly number[], weights: readonly number[], places: number): (number | null)[] {
  return Array.from({ length: places }, (_, place) => {
    let [sum, whole] = [0, 0];
    along.forEach((at, row) => {
      const weight = (weights[row] ?? 0) * Math.exp(-(((at - (place + 0.5) / places) / ALONG) ** 2) / 2);
      [sum, whole] = [sum + weight * (values[row] ?? 0), whole + weight];
    });
    return whole > LEAST ? sum / whole : null;
  });
}
